//! One robot of the scene: its frames, the shapes of its links, the frames and paths of its tasks, forces.

import { Color, Group, Material, Mesh, MeshLambertMaterial, Object3D, Quaternion, Vector3 } from "three";
import type { Label } from "./labels.ts";
import { Arrow, Rod, Trail, capsule, onTop, triad } from "./parts.ts";
import { SHADOW, SOLID, type Stage } from "./stage.ts";
import { comparedColor, onTheme, theme } from "./theme.ts";

/** How a robot among several looks. */
export interface Look {
  /** Marks it. */
  color?: number;
  /** Place among the robots, from 0. */
  number?: number;
  /** Translucent: it is drawn where another robot is. */
  isGhost?: boolean;
  /** Has links and paths only: the robot with which it is compared has the rest. */
  isPlain?: boolean;
  /** Precedes the names of its forces and frames. */
  name?: string;
}

export interface Pose {
  position: Vector3;
  rotation: Quaternion;
}

/** Radius of the line that stands for a link without a shape, m. */
const STICK_M = 0.012;
/** Length of the arrow of a force, m/N. */
const ARROW_M_PER_N = 0.015;
/** An arrow that is longer would leave the picture, m. */
const LONGEST_ARROW_M = 0.4;
/** Force that is shown, N: below it an arrow is shorter than its head. */
const LEAST_FORCE_N = 0.3;
const PATH_POINTS = 250;
const GHOST_OPACITY = 0.4;

/** Kinds of shapes of a link; only those of the best kind that there is are shown. */
export type ShapeKind = "visual" | "collision" | "stick";
const KINDS: ShapeKind[] = ["visual", "collision", "stick"];

export class Robot {
  /** The robot's world: all that belongs to it is drawn in it. It is moved where robots with one base are drawn apart. */
  readonly root = new Group();
  private readonly frames = new Map<string, Object3D>();
  private readonly shapes = new Map<string, Map<ShapeKind, Object3D>>();
  private readonly tasks = new Map<string, TaskFrames>();
  private readonly forces = new Map<string, ForceArrow>();
  private readonly materials: [MeshLambertMaterial, MeshLambertMaterial];
  private readonly selectedMaterial: MeshLambertMaterial;
  private selected = "";
  readonly color: number | undefined;
  /** Says where the robot is drawn, if not where it is. */
  apart = "";

  constructor(private readonly stage: Stage, readonly prefix: string, readonly look: Look = {}) {
    const { color, number = 0, isGhost = false } = look;
    this.color = color;
    const material = () =>
      new MeshLambertMaterial({
        transparent: isGhost,
        opacity: isGhost ? GHOST_OPACITY : 1,
        // Where robots coincide, the first one is seen.
        polygonOffset: isGhost,
        polygonOffsetFactor: number,
        polygonOffsetUnits: 4 * number,
      });
    this.materials = [material(), material()];
    this.selectedMaterial = material();
    onTheme(colors => {
      this.materials.forEach((material, i) => {
        material.color.set(colors.links[i]!);
        if (color !== undefined) material.color.lerp(new Color(color), i === 0 ? 0.75 : 0.95);
      });
      this.selectedMaterial.color.set(colors.hand).lerp(new Color(0xffffff), 0.25);
    });
    stage.scene.add(this.root);
  }

  remove(): void {
    this.root.removeFromParent();
    for (const task of this.tasks.values()) task.remove();
    for (const force of this.forces.values()) force.remove();
  }

  /** Frame of that name; it is in the world until its parent is known. */
  frame(name: string): Object3D {
    let frame = this.frames.get(name);
    if (!frame) {
      frame = new Group();
      frame.name = name;
      this.frames.set(name, frame);
      this.root.add(frame);
    }
    return frame;
  }

  frameNames(): string[] {
    return [...this.frames.keys()];
  }

  hasFrame(name: string): boolean {
    return this.frames.has(name);
  }

  /** True for the frame in which the robot stands. */
  isWorld(name: string): boolean {
    const frame = this.frames.get(name);
    return !frame || frame.parent === this.root;
  }

  place(parent: string, child: string, { position, rotation }: Pose): void {
    const [above, frame] = [this.frame(parent), this.frame(child)];
    if (frame.parent !== above) above.add(frame);
    frame.position.copy(position);
    frame.quaternion.copy(rotation);
  }

  /** Position of a frame in the robot's world, m. */
  position(frame: string): Vector3 {
    return this.pointOf(frame, new Vector3());
  }

  /** Position (m) in the robot's world of a point of a frame. */
  pointOf(frame: string, point: Vector3): Vector3 {
    const object = this.frame(frame);
    object.updateWorldMatrix(true, false);
    return this.root.worldToLocal(object.localToWorld(point.clone()));
  }

  /** Place (m) in the scene of a point of the robot's world. */
  drawnAt(point: Vector3): Vector3 {
    this.root.updateWorldMatrix(true, false);
    return this.root.localToWorld(point.clone());
  }

  /** Gives a link a shape of a kind, in place of the former one. Its parts without a material get that of the robot. */
  setShape(link: string, kind: ShapeKind, shape: Object3D): void {
    const own = this.shapes.get(link) ?? new Map<ShapeKind, Object3D>();
    this.shapes.set(link, own);
    own.get(kind)?.removeFromParent();
    own.set(kind, shape);
    const number = [...this.shapes.keys()].indexOf(link);
    shape.traverse(part => {
      part.layers.set(SOLID);
      if (!this.look.isGhost) part.layers.enable(SHADOW);
      part.userData["link"] = link;
      if (part instanceof Mesh && (this.color !== undefined || part.material === undefined || part.userData["plain"])) {
        part.material = this.materials[number % 2]!;
      }
    });
    this.frame(link).add(shape);
    const best = KINDS.find(other => own.has(other));
    // Simple shapes leave gaps, which lines bridge.
    for (const [other, object] of own) object.visible = other === best || (other === "stick" && best === "visual");
    this.select(this.selected);
  }

  /** Material for shapes that have none of their own. */
  get plain(): Material {
    return this.materials[0];
  }

  /** Draws lines to the frames behind a link that has no shape, or only simple ones of its URDF. */
  addSticks(): void {
    for (const [name, frame] of this.frames) {
      const has = this.shapes.get(name);
      const isWhole = has?.has("visual") ? has.get("visual")!.userData["isMesh"] : has?.has("collision");
      // The frame at the top is the world.
      if (isWhole || frame.parent === this.root) continue;
      const ends = frame.children.filter(child => this.frames.get(child.name) === child && child.position.length() > STICK_M);
      if (ends.length === 0) continue;
      const sticks = new Group();
      for (const end of ends) {
        const stick = capsule(new Vector3(), end.position.clone(), STICK_M, this.plain);
        stick.userData["plain"] = true;
        sticks.add(stick);
      }
      this.setShape(name, "stick", sticks);
    }
  }

  /** Marks a link; "" marks none. */
  select(link: string): void {
    this.selected = link;
    for (const [name, kinds] of this.shapes) {
      for (const shape of kinds.values()) {
        shape.traverse(part => {
          if (!(part instanceof Mesh)) return;
          part.userData["own"] ??= part.material;
          part.material = name === link ? this.selectedMaterial : part.userData["own"];
        });
      }
    }
    this.stage.request();
  }

  /** Shapes that a ray can meet. */
  solids(): Object3D[] {
    return [...this.shapes.values()].flatMap(kinds => [...kinds.values()].filter(shape => shape.visible));
  }

  task(name: string): TaskFrames {
    let task = this.tasks.get(name);
    if (!task) {
      task = new TaskFrames(this.stage, this, name);
      this.tasks.set(name, task);
    }
    return task;
  }

  /** Shows a force (N) at a point (m), both in the robot's world. */
  setForce(name: string, at: Vector3, force_n: Vector3): void {
    if (this.look.isPlain) return;
    let arrow = this.forces.get(name);
    if (!arrow) {
      arrow = new ForceArrow(this.stage, this.root, this.ownName(name.replace(/\.(force|wrench)$/, "")), theme().force);
      this.forces.set(name, arrow);
    }
    arrow.set(at, force_n);
  }

  /** Name of something of this robot in a scene of several. */
  ownName(name: string): string {
    return [this.look.name, name].filter(Boolean).join(" ");
  }

  clearTrails(): void {
    for (const task of this.tasks.values()) task.clear();
  }
}

/** Look of a robot among several. Those that have the same task, which are compared, are ghosts of the first one. */
export function lookOf(number: number, name: string, isCompared: boolean): Look {
  const color = comparedColor(number);
  return isCompared ? { color, number, isGhost: number > 0, isPlain: number > 0 } : { color, number, name };
}

/** Reference and controlled frame of a task, with their paths. */
export class TaskFrames {
  private readonly group = new Group();
  private readonly reference = onTop(triad(0.11, 0.0018, 0.55), 2);
  private readonly controlled = onTop(triad(0.075, 0.0028), 3);
  private readonly referencePath: Trail;
  private readonly path: Trail;
  private readonly labels: Label[];
  private readonly referenceLabel: Label;
  private readonly isPlain: boolean;
  private readonly name: string;

  constructor(private readonly stage: Stage, robot: Robot, name: string) {
    this.isPlain = robot.look.isPlain ?? false;
    this.name = robot.ownName(name);
    const colors = theme();
    this.referencePath = new Trail(colors.reference, 0.0016, PATH_POINTS, 0.6);
    this.path = new Trail(robot.color ?? colors.force, 0.0026, PATH_POINTS);
    onTheme(colors => {
      this.referencePath.material.color.set(colors.reference);
      this.path.material.color.set(robot.color ?? colors.hand);
    });
    this.reference.visible = this.controlled.visible = false;
    this.group.add(...(this.isPlain ? [this.path] : [this.reference, this.controlled, this.referencePath, this.path]));
    robot.root.add(this.group);
    const where = new Vector3(0.012, 0.012, 0.012);
    this.referenceLabel = stage.labels.add(this.isPlain ? "" : `${this.name} reference`, this.reference, "frame reference", where);
    this.labels = [stage.labels.add(this.isPlain ? "" : this.name, this.controlled, "frame", where), this.referenceLabel];
  }

  remove(): void {
    this.group.removeFromParent();
    this.labels.forEach(label => this.stage.labels.remove(label));
  }

  setReference(pose: Pose): void {
    show(this.reference, pose);
    // Where both are at one place, one name is enough.
    const isNear = this.controlled.visible && this.controlled.position.distanceTo(pose.position) < 0.03;
    this.referenceLabel.element.textContent = isNear || this.isPlain ? "" : `${this.name} reference`;
  }

  setReferencePath(points: Vector3[]): void {
    this.referencePath.clear();
    points.forEach(point => this.referencePath.add_point(point));
  }

  appendReference(point: Vector3): void {
    this.referencePath.add_point(point);
  }

  setControlled(pose: Pose): void {
    show(this.controlled, pose);
    this.path.add_point(pose.position);
  }

  clear(): void {
    this.path.clear();
    this.referencePath.clear();
  }
}

function show(object: Object3D, { position, rotation }: Pose): void {
  object.visible = true;
  object.position.copy(position);
  object.quaternion.copy(rotation);
}

/** Force as an arrow with its size in newtons. */
class ForceArrow {
  private readonly arrow: Arrow;
  private readonly tip = new Object3D();
  private readonly label: Label;

  constructor(private readonly stage: Stage, world: Object3D, private readonly name: string, color: number) {
    this.arrow = onTop(new Arrow(color, 0.006), 4);
    world.add(this.arrow, this.tip);
    this.label = stage.labels.add("", this.tip, "force");
  }

  set(at: Vector3, force_n: Vector3): void {
    const size_n = force_n.length();
    const isShown = Number.isFinite(size_n) && size_n >= LEAST_FORCE_N;
    this.label.element.textContent = isShown ? `${this.name} ${size_n.toFixed(1)} N` : "";
    const length = Math.min(LONGEST_ARROW_M, size_n * ARROW_M_PER_N);
    const vector = isShown ? force_n.clone().multiplyScalar(length / size_n) : new Vector3();
    this.arrow.set(at, vector);
    this.tip.position.copy(at).add(vector);
  }

  remove(): void {
    this.arrow.removeFromParent();
    this.tip.removeFromParent();
    this.stage.labels.remove(this.label);
  }
}

/** Spring of the hand: from the grasped point to the pointer, with its force. */
export class HandSpring {
  private readonly rod: Rod;
  private readonly middle = new Object3D();
  private readonly label: Label;

  constructor(private readonly stage: Stage) {
    this.rod = onTop(new Rod(theme().hand, 0.0035), 5);
    onTheme(colors => this.rod.material.color.set(colors.hand));
    stage.scene.add(this.rod, this.middle);
    this.label = stage.labels.add("", this.middle, "hand");
  }

  set(from: Vector3, to: Vector3, force_n: number): void {
    this.rod.set(from, to);
    this.middle.position.copy(to);
    this.label.element.textContent = `${force_n.toFixed(1)} N`;
    this.stage.request();
  }

  hide(): void {
    this.rod.visible = false;
    this.label.element.textContent = "";
    this.stage.request();
  }
}
