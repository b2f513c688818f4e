//! Forward kinematics of a tree of joints: each moves along or about the z axis of its body.

import { Matrix4, Quaternion, Vector3 } from "three";

/** Position x, y, z (m), then the quaternion x, y, z, w. */
export type PlacementArray = [number, number, number, number, number, number, number];

export interface Body {
  /** Index of the parent, which comes before its children; -1 is the base. */
  parent: number;
  /** Pose in the parent at joint position zero. */
  origin: PlacementArray;
  slides: boolean;
  joint: number;
  /** Position of the joint: ratio · q + offset. */
  ratio: number;
  offset: number;
}

export function matrix([x, y, z, i, j, k, w]: PlacementArray): Matrix4 {
  return new Matrix4().compose(new Vector3(x, y, z), new Quaternion(i, j, k, w), new Vector3(1, 1, 1));
}

/** Placements of the bodies in the world at joint positions q (rad or m). */
export class Kinematics {
  readonly placements: Matrix4[];
  private readonly origins: Matrix4[];
  private readonly base: Matrix4;
  private readonly motion = new Matrix4();

  constructor(base: PlacementArray, private readonly bodies: Body[]) {
    this.base = matrix(base);
    this.origins = bodies.map(body => matrix(body.origin));
    this.placements = bodies.map(() => new Matrix4());
  }

  /** Placement of a body; -1 is the base. */
  placement(body: number): Matrix4 {
    return this.placements[body] ?? this.base;
  }

  update(q: ArrayLike<number>): void {
    this.bodies.forEach((body, i) => {
      const position = body.ratio * (q[body.joint] ?? 0) + body.offset;
      if (body.slides) this.motion.makeTranslation(0, 0, position);
      else this.motion.makeRotationZ(position);
      this.placements[i]!.multiplyMatrices(this.placement(body.parent), this.origins[i]!).multiply(this.motion);
    });
  }
}
