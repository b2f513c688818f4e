//! State of the view, as the topic `/view` has it.

export interface Gains {
  natural_frequency_rad_per_s: number;
  damping_ratio: number;
}

export interface TaskState {
  name: string;
  frame: string;
  /** By axis; null if the task does not take gains as inputs. */
  gains: Record<string, Gains> | null;
  modes: Record<string, string> | null;
}

export interface HandState {
  frame: string;
  target_m: [number, number, number];
  stiffness_n_per_m: number;
  damping_ns_per_m: number;
  largest_force_n: number;
  force_n: [number, number, number];
}

export interface RobotState {
  prefix: string;
  name: string;
  label: string;
  /** True for a robot with the same task that runs beside others, to be compared with them. */
  is_compared: boolean;
  /** Name of the robot before it that has the same base; null if none has. */
  same_base_as: string | null;
  can_push: boolean;
  units: Record<string, string>;
  hand: HandState | null;
  tasks: TaskState[];
}

export interface ViewState {
  title: string;
  kind: "run" | "log";
  time_s: number;
  duration_s: number;
  speed: number;
  state: "playing" | "paused" | "ended";
  outcome: string | null;
  late_cycles: number;
  dropped_pictures: number;
  robots: RobotState[];
}

/** Name of a robot: what distinguishes compared robots is their interface and controller. */
export function shownName({ label, name, is_compared }: RobotState, several: boolean): string {
  if (several) return is_compared ? label || name : name;
  return [name, label].filter(Boolean).join(", ");
}

/** Name of the signal of the x of the position of the first task that has a reference, too. */
export function controlledPosition(units: Record<string, string>): string | undefined {
  const isOfTask = (name: string) => /^(?!target\.).+\.position\.x$/.test(name) && name.replace(/position\.x$/, "reference.x") in units;
  return Object.keys(units).find(isOfTask);
}

/** Scalars of a robot at a time. */
export interface Signals {
  time_s: number;
  values: Record<string, number>;
}
