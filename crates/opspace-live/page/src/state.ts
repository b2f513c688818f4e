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

/** Scalars of a robot at a time. */
export interface Signals {
  time_s: number;
  values: Record<string, number>;
}
