//! Scene of a run from the data in a report: forward kinematics in place of messages.

import { Matrix4, Object3D, Quaternion, Vector3 } from "three";
import { placeApart } from "./apart.ts";
import { Environment } from "./environment.ts";
import { Kinematics, matrix } from "./kinematics.ts";
import { capsule } from "./parts.ts";
import { Robot, lookOf, type Look, type Pose } from "./robot.ts";
import { Pictures, type RunData, type RunsData } from "./run_data.ts";
import type { Stage } from "./stage.ts";
import { visuals } from "./urdf.ts";

/** Length of the paths, s. */
const PATH_S = 3;
/** Size of a wall along its plane, and its thickness, m. */
const WALL_M = new Vector3(0.01, 1, 1);

/** All robots of a run. */
export class RunScene {
  readonly robots: RunRobot[];
  readonly start_s: number;
  readonly end_s: number;

  constructor(private readonly stage: Stage, { robots, are_compared }: RunsData) {
    const environment = new Environment(stage);
    const isAt = (a: RunData, b: RunData) => a.base.every((value, i) => Math.abs(value - b.base[i]!) < 1e-6);
    this.robots = robots.map((data, number) => {
      const look = robots.length === 1 ? {} : lookOf(number, data.name, are_compared);
      return new RunRobot(stage, environment, data, look);
    });
    this.start_s = Math.min(...robots.map(data => data.start_s));
    this.end_s = Math.max(...robots.map(data => data.start_s + (data.pictures - 1) * data.period_s));
    this.show(this.start_s);
    const sameBaseAs = (data: RunData, number: number) =>
      are_compared ? undefined : robots.slice(0, number).find(other => isAt(other, data))?.name;
    placeApart(this.robots.map(({ robot, data }, k) => ({ robot, name: data.name, sameBaseAs: sameBaseAs(data, k) })), stage);
    this.frame();
  }

  /** Places the camera so that the robots are seen. */
  frame(): void {
    this.stage.show(this.robots.map(({ robot }) => robot.root));
  }

  /** Shows the run at a time, s. */
  show(time_s: number): void {
    this.robots.forEach(robot => robot.show(time_s));
    this.stage.request();
  }
}

/** One robot of the run. */
export class RunRobot {
  readonly robot: Robot;
  private readonly kinematics: Kinematics;
  private readonly pictures: Pictures;
  private readonly placements: Matrix4[];
  private lastPlace = NaN;

  constructor(stage: Stage, private readonly environment: Environment, readonly data: RunData, look: Look) {
    this.robot = new Robot(stage, "", look);
    this.kinematics = new Kinematics(data.base, data.bodies);
    this.pictures = new Pictures(data);
    this.placements = data.frames.map(frame => matrix(frame.placement));
    const links = new Map<number, Object3D>();
    for (const { name, frame, start_m, end_m, radius_m } of data.capsules) {
      const [start, end] = [new Vector3(...start_m), new Vector3(...end_m)];
      if (frame < 0) {
        this.environment.addCapsule(this.robot.root, this.robot.ownName(name), start, end, radius_m);
        continue;
      }
      const link = links.get(frame) ?? new Object3D();
      links.set(frame, link.add(capsule(start, end, radius_m, this.robot.plain)));
      link.children.forEach(part => (part.userData["plain"] = true));
    }
    data.frames.forEach(frame => this.robot.frame(frame.name));
    visuals(data.urdf, (link, shape) => this.robot.hasFrame(link) && this.robot.setShape(link, "visual", shape));
    for (const [frame, shape] of links) this.robot.setShape(data.frames[frame]!.name, "collision", shape);
    for (const { name, point_m, normal } of data.walls) {
      const out = new Vector3(...normal).normalize();
      const center = new Vector3(...point_m).addScaledVector(out, -0.5 * WALL_M.x);
      this.environment.addWall(this.robot.root, this.robot.ownName(name), center, out, WALL_M);
    }
  }

  /** Shows the run at a time, s. */
  show(time_s: number): void {
    const last = this.data.pictures - 1;
    const place = Math.min(last, Math.max(0, (time_s - this.data.start_s) / this.data.period_s));
    const step = place - this.lastPlace;
    const most = Math.ceil(PATH_S / this.data.period_s);
    if (!(step >= 0 && step < 0.25 * most)) {
      this.robot.clearTrails();
      for (let picture = Math.max(0, Math.floor(place) - most); picture < place; picture++) this.place(picture);
    }
    this.place(place);
    this.lastPlace = place;
  }

  private place(place: number): void {
    const { data, robot } = this;
    const row = this.pictures.at(place);
    this.kinematics.update(row);
    const poses = data.frames.map((frame, i) =>
      new Matrix4().multiplyMatrices(this.kinematics.placement(frame.body), this.placements[i]!),
    );
    data.frames.forEach((frame, i) => robot.place("world", frame.name, pose(poses[i]!)));
    for (const { name, frame, relative_to, reference } of data.tasks) {
      const task = robot.task(name);
      if (frame >= 0) task.setControlled(pose(poses[frame]!));
      const [x, y, z, w, i, j, k] = row.slice(reference, reference + 7);
      if ([x, y, z, w, i, j, k].some(value => !Number.isFinite(value))) continue;
      const placed = new Matrix4().compose(
        new Vector3(x, y, z),
        new Quaternion(i, j, k, w).normalize(),
        new Vector3(1, 1, 1),
      );
      if (relative_to >= 0) placed.premultiply(poses[relative_to]!);
      const shown = pose(placed);
      task.setReference(shown);
      task.appendReference(shown.position);
    }
    for (const { name, frame, column } of data.forces) {
      const force = new Vector3(row[column], row[column + 1], row[column + 2]);
      robot.setForce(name, pose(poses[frame]!).position, force);
    }
    for (const { name, column, orientation, box_m, diameter_m } of data.objects) {
      const [w = 1, x = 0, y = 0, z = 0] = orientation < 0 ? [] : row.slice(orientation, orientation + 4);
      const position = new Vector3(row[column], row[column + 1], row[column + 2]);
      const isThere = [w, x, y, z, position.length()].every(Number.isFinite);
      const placed = isThere ? { position, rotation: new Quaternion(x, y, z, w).normalize() } : undefined;
      this.environment.showObject(robot.root, name, placed, box_m ? new Vector3(...box_m) : undefined, diameter_m);
    }
  }

  /** Positions of all frames in the robot's world, m. */
  frames(): Record<string, [number, number, number]> {
    const names = this.data.frames.map(frame => frame.name);
    return Object.fromEntries(names.map(name => [name, this.robot.position(name).toArray()]));
  }
}

function pose(placement: Matrix4): Pose {
  const [position, rotation] = [new Vector3(), new Quaternion()];
  placement.decompose(position, rotation, new Vector3());
  return { position, rotation };
}

