//! Data of a run in a report, as `run_pictures.rs` writes them.

import type { Body, PlacementArray } from "./kinematics.ts";

type Triple = [number, number, number];

/** All robots of a run. */
export interface RunsData {
  /** True for robots with the same task, which are compared. */
  are_compared: boolean;
  robots: RunData[];
}

export interface RunData {
  name: string;
  /** Time of the first picture after the start of control, of the first robot if there are several, and between two pictures, s. */
  start_s: number;
  period_s: number;
  pictures: number;
  base: PlacementArray;
  /** Links of the URDF with their visual shapes. */
  urdf: string;
  bodies: Body[];
  frames: { name: string; body: number; placement: PlacementArray }[];
  /** Capsules of links, by the index of their frame, and of the world (-1). */
  capsules: { name: string; frame: number; start_m: Triple; end_m: Triple; radius_m: number }[];
  walls: { name: string; point_m: Triple; normal: Triple }[];
  /** Cartesian tasks: the index of the controlled frame, that of the frame of the reference (-1: world), and its first column:
   * position (m), quaternion w, x, y, z. */
  tasks: { name: string; frame: number; relative_to: number; reference: number }[];
  /** Forces: index of the frame on whose origin they act, and first column (N). */
  forces: { name: string; frame: number; column: number }[];
  /** Objects: first column of position (m), that of the quaternion w, x, y, z (-1: none), size of a box (m), or diameter of a ball (m). */
  objects: { name: string; column: number; orientation: number; box_m: Triple | null; diameter_m: number }[];
  /** Smallest value and step of each column; the joint positions come first. */
  columns: [number, number][];
  /** Columns of angles without limits, which are written modulo one turn. */
  turning: number[];
  /** Columns of all pictures, as base64 of 16-bit numbers. A value that does not apply is 65535. */
  values: string;
}

const MISSING = 65535;

/** Values of the columns at any time. */
export class Pictures {
  private readonly numbers: DataView;
  private readonly turning: Set<number>;
  readonly row: Float64Array;

  constructor(private readonly data: RunData) {
    const bytes = Uint8Array.from(atob(data.values), character => character.charCodeAt(0));
    this.numbers = new DataView(bytes.buffer);
    this.row = new Float64Array(data.columns.length);
    this.turning = new Set(data.turning);
  }

  /** Value of a column in a picture; NaN if it does not apply. */
  value(picture: number, column: number): number {
    const number = this.numbers.getUint16(2 * (picture * this.data.columns.length + column), true);
    const [low, step] = this.data.columns[column]!;
    return number === MISSING ? NaN : low + number * step;
  }

  /** Fills the row with the values at a place between pictures. */
  at(place: number): Float64Array {
    const last = this.data.pictures - 1;
    const before = Math.min(last, Math.max(0, Math.floor(place)));
    const share = Math.min(1, Math.max(0, place - before));
    for (let column = 0; column < this.row.length; column++) {
      const value = this.value(before, column);
      const next = before < last && share > 0 ? this.value(before + 1, column) : value;
      let change = Number.isNaN(next) ? 0 : next - value;
      if (this.turning.has(column)) change -= 2 * Math.PI * Math.round(change / (2 * Math.PI));
      this.row[column] = value + share * change;
    }
    return this.row;
  }
}
