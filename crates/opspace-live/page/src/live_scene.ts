//! Scene of the live view from messages: a robot for each prefix of topics, and the environment.

import { Group, Object3D, Quaternion, Vector3 } from "three";
import { placeApart } from "./apart.ts";
import { Environment } from "./environment.ts";
import { entities, poseInFrame, rosText, transforms, type Entity } from "./messages.ts";
import { loadMesh } from "./meshes.ts";
import { capsule } from "./parts.ts";
import { Robot, lookOf } from "./robot.ts";
import type { Stage } from "./stage.ts";
import type { RobotState } from "./state.ts";
import { visuals } from "./urdf.ts";

/** Length of the arrow of a force in `/scene/forces`, m/N. */
const ARROW_M_PER_N = 0.01;
const X = new Vector3(1, 0, 0);

export class LiveScene {
  readonly robots = new Map<string, Robot>();
  private readonly environment: Environment;
  private framed = 0;
  private states: RobotState[] = [];
  private readonly moved = new Set<string>();
  private readonly early: [Robot, Entity][] = [];

  constructor(private readonly stage: Stage) {
    this.environment = new Environment(stage);
  }

  /** Makes the robots; those that are no longer there are removed. */
  setRobots(states: RobotState[]): void {
    this.states = states;
    for (const [prefix, robot] of this.robots) {
      if (states.some(state => state.prefix === prefix)) continue;
      robot.remove();
      this.robots.delete(prefix);
    }
    states.forEach((state, number) => {
      if (this.robots.has(state.prefix)) return;
      const look = states.length === 1 ? {} : lookOf(number, state.name, state.is_compared);
      this.robots.set(state.prefix, new Robot(this.stage, state.prefix, look));
    });
  }

  /** Shows a message. Returns false for a topic that is no part of the scene. */
  message(topic: string, schema: string, bytes: Uint8Array): boolean {
    const [robot, name] = this.owner(topic);
    if (!robot) return false;
    if (name === "/tf" || name === "/tf_static") {
      for (const transform of transforms(bytes)) robot.place(transform.parent, transform.child, transform);
      if (name === "/tf" && !this.moved.has(robot.prefix)) {
        this.moved.add(robot.prefix);
        this.early.splice(0).forEach(([robot, entity]) => this.addEntity(robot, entity));
      }
    } else if (name === "/robot_description") {
      const found = (link: string, shape: Object3D) => {
        robot.setShape(link, "visual", shape);
        this.stage.request();
      };
      visuals(rosText(bytes), found, loadMesh);
    } else if (name === "/scene/collision" || name === "/scene/environment") {
      entities(bytes).forEach(entity => this.addEntity(robot, entity));
    } else if (name === "/scene/objects") {
      for (const { id, cubes, spheres } of entities(bytes)) {
        const [box, ball] = [cubes[0], spheres[0]];
        this.environment.showObject(robot.root, id, box ?? ball, box ? box.size : undefined, ball?.size.x);
      }
    } else if (name === "/scene/forces") {
      for (const { id, arrows } of entities(bytes)) {
        const arrow = arrows[0];
        const force = new Vector3();
        if (arrow) force.copy(X).applyQuaternion(arrow.rotation).multiplyScalar(arrow.length / ARROW_M_PER_N);
        robot.setForce(id, arrow?.position ?? new Vector3(), force);
      }
    } else if (name === "/scene/paths") {
      for (const { id, frame, lines } of entities(bytes)) {
        const task = robot.task(id.replace(/\.reference$/, ""));
        const points = lines[0] ?? [];
        task.setReferencePath(robot.hasFrame(frame) ? points.map(point => robot.pointOf(frame, point)) : points);
      }
    } else if (schema === "foxglove.PoseInFrame") {
      const shown = poseInFrame(bytes);
      const [, task = "", what] = name.split("/");
      if (robot.hasFrame(shown.frame)) {
        shown.position = robot.pointOf(shown.frame, shown.position);
        shown.rotation.premultiply(robot.frame(shown.frame).getWorldQuaternion(new Quaternion()));
      }
      if (what === "reference") robot.task(task).setReference(shown);
      else if (what === "controlled_frame") robot.task(task).setControlled(shown);
    } else {
      return false;
    }
    this.frame();
    this.stage.request();
    return true;
  }

  clearTrails(): void {
    this.robots.forEach(robot => robot.clearTrails());
  }

  /** Robot of a topic, and the topic without its prefix. */
  owner(topic: string): [Robot | undefined, string] {
    // A prefix may begin another one.
    const prefixes = [...this.robots.keys()].sort((a, b) => b.length - a.length);
    const prefix = prefixes.find(prefix => topic.startsWith(`${prefix}/`));
    return prefix === undefined ? [undefined, topic] : [this.robots.get(prefix), topic.slice(prefix.length)];
  }

  private addEntity(robot: Robot, entity: Entity): void {
    // Which frame is the world is known from the transforms.
    if (!this.moved.has(robot.prefix)) {
      this.early.push([robot, entity]);
      return;
    }
    const shape = new Group();
    const ends = entity.spheres.map(sphere => sphere.position);
    const radius = (entity.spheres[0]?.size.x ?? entity.cylinders[0]?.size.x ?? 0) / 2;
    const isInWorld = robot.isWorld(entity.frame);
    const [start, end = start] = ends;
    if (start && end) {
      if (isInWorld) {
        this.environment.addCapsule(robot.root, robot.ownName(entity.id), start, end, radius);
        return;
      }
      const part = capsule(start, end, radius, robot.plain);
      part.userData["plain"] = true;
      shape.add(part);
    }
    for (const { position, rotation, size } of entity.cubes) {
      this.environment.addWall(robot.root, robot.ownName(entity.id), position, X.clone().applyQuaternion(rotation), size);
    }
    if (shape.children.length > 0) this.addToLink(robot, entity.frame, entity.id, shape);
  }

  /** A link may have several capsules, which arrive as entities of their own. */
  private addToLink(robot: Robot, link: string, id: string, part: Object3D): void {
    const whole = this.capsules.get(robot) ?? new Map<string, Map<string, Object3D>>();
    this.capsules.set(robot, whole);
    const parts = whole.get(link) ?? new Map<string, Object3D>();
    whole.set(link, parts.set(id, part));
    robot.setShape(link, "collision", new Group().add(...parts.values()));
  }

  private readonly capsules = new WeakMap<Robot, Map<string, Map<string, Object3D>>>();

  /** Places the camera once all robots have moved to their start. */
  private frame(): void {
    if (this.framed === this.robots.size || this.moved.size < this.robots.size) return;
    this.framed = this.robots.size;
    // Messages that are written once arrive together with the first picture.
    setTimeout(() => this.begin(), 150);
  }

  private begin(): void {
    this.robots.forEach(robot => robot.addSticks());
    const robots = this.states.flatMap(({ prefix, name, same_base_as, is_compared }) => {
      const robot = this.robots.get(prefix);
      return robot ? [{ robot, name, sameBaseAs: is_compared ? undefined : (same_base_as ?? undefined) }] : [];
    });
    placeApart(robots, this.stage);
    this.show();
  }

  /** Places the camera so that all robots are seen. */
  show(): void {
    this.robots.forEach(robot => robot.addSticks());
    this.stage.show([...this.robots.values()].map(robot => robot.root));
  }
}
