//! Robots whose bases coincide, drawn side by side.

import { Box3, Vector3 } from "three";
import type { Robot } from "./robot.ts";
import { SOLID, type Stage } from "./stage.ts";

/** Gap between two robots, relative to the size of the second one, and the step of its distance, m. */
const GAP = 0.2;
const STEP_M = 0.1;
/** Direction of the camera, from which robots side by side are seen apart: angle from x about z, and elevation, rad. */
const LOOK_RAD = [-0.5, 0.36] as const;

export interface Placed {
  robot: Robot;
  name: string;
  /** Name of the robot before it whose base it has. */
  sameBaseAs: string | undefined;
}

/** Moves each robot whose base is that of another one along y, beyond all robots before it. */
export function placeApart(robots: Placed[], stage: Stage): void {
  const before = new Box3();
  for (const { robot, sameBaseAs } of robots) {
    const box = boxOf(robot);
    if (sameBaseAs !== undefined && !box.isEmpty() && !before.isEmpty()) {
      const gap_m = GAP * box.getSize(new Vector3()).length();
      const y_m = STEP_M * Math.ceil((before.max.y - box.min.y + gap_m) / STEP_M);
      robot.root.position.y = y_m;
      robot.apart = `drawn ${y_m.toFixed(1)} m along y, as its base is that of ${sameBaseAs}`;
      box.translate(new Vector3(0, y_m, 0));
      stage.orbit.lookFrom(...LOOK_RAD);
    }
    before.union(box);
  }
}

/** Box around the links of a robot and the walls that it touches. */
function boxOf(robot: Robot): Box3 {
  const box = new Box3();
  robot.root.updateWorldMatrix(true, true);
  robot.root.traverse(part => {
    if (part.layers.isEnabled(SOLID) || part.userData["isWall"]) box.expandByObject(part);
  });
  return box;
}
