//! Messages for viewers: those types and fields of Foxglove's schemas that opspace writes.

import { Quaternion, Vector3 } from "three";
import { Message } from "./protobuf.ts";
import type { Pose } from "./robot.ts";

export interface Transform extends Pose {
  parent: string;
  child: string;
}

export interface Entity {
  frame: string;
  id: string;
  /** Arrows along x of their pose; length of shaft and head together, m. */
  arrows: (Pose & { length: number })[];
  cubes: (Pose & { size: Vector3 })[];
  spheres: (Pose & { size: Vector3 })[];
  /** Cylinders along z of their pose. */
  cylinders: (Pose & { size: Vector3 })[];
  lines: Vector3[][];
}

/** `foxglove.FrameTransforms`. */
export function transforms(bytes: Uint8Array): Transform[] {
  return new Message(bytes).messages(1).map(transform => ({
    parent: transform.text(2),
    child: transform.text(3),
    position: vector(transform.message(4)),
    rotation: quaternion(transform.message(5)),
  }));
}

/** `foxglove.PoseInFrame`. */
export function poseInFrame(bytes: Uint8Array): Pose & { frame: string } {
  const message = new Message(bytes);
  return { frame: message.text(2), ...pose(message.message(3)) };
}

/** `foxglove.SceneUpdate`. */
export function entities(bytes: Uint8Array): Entity[] {
  return new Message(bytes).messages(2).map(entity => ({
    frame: entity.text(2),
    id: entity.text(3),
    arrows: entity.messages(7).map(arrow => ({
      ...pose(arrow.message(1)),
      length: arrow.number(2) + arrow.number(4),
    })),
    cubes: entity.messages(8).map(sized),
    spheres: entity.messages(9).map(sized),
    cylinders: entity.messages(10).map(sized),
    lines: entity.messages(11).map(line => line.messages(5).map(vector)),
  }));
}

/** `std_msgs/msg/String` in CDR: a header of four bytes, the length with the final zero, the text. */
export function rosText(bytes: Uint8Array): string {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const length = view.getUint32(4, true);
  return new TextDecoder().decode(bytes.subarray(8, 8 + Math.max(0, length - 1)));
}

function sized(shape: Message): Pose & { size: Vector3 } {
  return { ...pose(shape.message(1)), size: vector(shape.message(2)) };
}

function pose(message: Message): Pose {
  return { position: vector(message.message(1)), rotation: quaternion(message.message(2)) };
}

function vector(message: Message): Vector3 {
  return new Vector3(message.number(1), message.number(2), message.number(3));
}

function quaternion(message: Message): Quaternion {
  return new Quaternion(message.number(1), message.number(2), message.number(3), message.number(4)).normalize();
}
