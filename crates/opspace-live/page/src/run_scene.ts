//! Scene of a run from the data in a report: forward kinematics in place of messages.

import { Matrix4, Object3D, Quaternion, Vector3 } from "three";
import { Environment } from "./environment.ts";
import { Kinematics, matrix } from "./kinematics.ts";
import { capsule } from "./parts.ts";
import { Robot, type Pose } from "./robot.ts";
import { Pictures, type RunData } from "./run_data.ts";
import type { Stage } from "./stage.ts";
import { visuals } from "./urdf.ts";

/** Length of the paths, s. */
const PATH_S = 3;
/** Size of a wall along its plane, and its thickness, m. */
const WALL_M = new Vector3(0.01, 1, 1);
const BALL_M = 0.04;

export class RunScene {
  readonly robot: Robot;
  private readonly environment: Environment;
  private readonly kinematics: Kinematics;
  private readonly pictures: Pictures;
  private readonly placements: Matrix4[];
  private lastPlace = NaN;

  constructor(private readonly stage: Stage, private readonly data: RunData) {
    this.robot = new Robot(stage, "");
    this.environment = new Environment(stage);
    this.kinematics = new Kinematics(data.base, data.bodies);
    this.pictures = new Pictures(data);
    this.placements = data.frames.map(frame => matrix(frame.placement));
    const links = new Map<number, Object3D>();
    for (const { name, frame, start_m, end_m, radius_m } of data.capsules) {
      const [start, end] = [new Vector3(...start_m), new Vector3(...end_m)];
      if (frame < 0) {
        this.environment.addCapsule(name, start, end, radius_m);
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
      this.environment.addWall(name, center, out, WALL_M);
    }
    for (const { name } of data.objects) this.environment.addBall(name, new Vector3(), BALL_M);
    this.show(0);
    this.frame();
  }

  /** Places the camera so that the robot is seen. */
  frame(): void {
    this.stage.show([this.robot.root]);
  }

  /** Shows the run at a place between pictures. */
  show(place: number): void {
    const step = place - this.lastPlace;
    const most = Math.ceil(PATH_S / this.data.period_s);
    if (!(step >= 0 && step < 0.25 * most)) {
      this.robot.clearTrails();
      for (let picture = Math.max(0, Math.floor(place) - most); picture < place; picture++) this.place(picture);
    }
    this.place(place);
    this.lastPlace = place;
    this.stage.request();
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
    for (const { name, column } of data.objects) {
      this.environment.move(name, new Vector3(row[column], row[column + 1], row[column + 2]));
    }
  }

  /** Positions of all frames in the world, m. */
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

