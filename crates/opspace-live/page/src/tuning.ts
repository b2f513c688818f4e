//! Gains and axis modes of the running task.

import { make, setText } from "./dom.ts";
import type { RobotState, TaskState } from "./state.ts";

const MODES = ["motion", "compliant", "force", "free"];
const MODE_HINTS: Record<string, string> = {
  motion: "follows the reference",
  compliant: "yields to forces, and stays where it is pushed to",
  force: "presses with the commanded force",
  free: "not in the task",
};
/** Range of the natural frequency, rad/s; its slider is logarithmic. */
const FREQUENCY_RAD_PER_S = [1, 60] as const;

type Control = (message: Record<string, unknown>) => void;

interface Row {
  show(task: TaskState): void;
}

export class Tuning {
  readonly element = make("section", { className: "tuning", hidden: true });
  private rows: { task: string; row: Row }[] = [];
  private signature = "";

  constructor(private readonly control: Control) {}

  show(robots: RobotState[]): void {
    // What the page sends acts on the tasks of that name of all robots: each is shown once.
    const tasks = new Map<string, TaskState>();
    for (const robot of robots) {
      for (const task of robot.tasks) {
        if ((task.gains || task.modes) && !tasks.has(task.name)) tasks.set(task.name, task);
      }
    }
    const axes = (task: TaskState) => [...new Set([...Object.keys(task.modes ?? {}), ...Object.keys(task.gains ?? {})])];
    const signature = [...tasks.values()].map(task => `${task.name}:${axes(task).join()}:${!task.gains}${!task.modes}`).join(";");
    if (signature !== this.signature) {
      this.signature = signature;
      this.rows = [];
      this.element.hidden = tasks.size === 0;
      const parts = [...tasks.values()].map(task => {
        const table = make("div", { className: "axes", role: "group", "aria-label": `Task ${task.name}` });
        table.append(make("h3", {}, task.name, make("span", {}, task.frame === task.name ? "" : ` of ${task.frame}`)));
        for (const axis of axes(task)) {
          const { element, row } = axisRow(task, axis, this.control);
          table.append(element);
          this.rows.push({ task: task.name, row });
        }
        return table;
      });
      this.element.replaceChildren(make("h2", {}, "Gains and axis modes"), ...parts);
    }
    for (const { task, row } of this.rows) row.show(tasks.get(task)!);
  }
}

function axisRow(task: TaskState, axis: string, control: Control): { element: HTMLElement; row: Row } {
  const element = make("div", { className: "axis-row" }, make("b", {}, axis));
  const shows: ((task: TaskState) => void)[] = [];
  if (task.modes?.[axis] !== undefined) {
    const mode = make("select", { "aria-label": `Mode of axis ${axis} of ${task.name}` });
    MODES.forEach(name => mode.add(Object.assign(new Option(name), { title: MODE_HINTS[name] })));
    mode.onchange = () => control({ op: "mode", task: task.name, axis, mode: mode.value });
    element.append(mode);
    shows.push(task => {
      const value = task.modes?.[axis];
      if (value === undefined || document.activeElement === mode) return;
      if (!MODES.includes(value) && ![...mode.options].some(option => option.value === value)) mode.add(new Option(value));
      mode.value = value;
    });
  }
  const gains = task.gains?.[axis];
  if (gains) {
    const frequency = slider(`Natural frequency of axis ${axis} of ${task.name}, rad/s`, Math.log(FREQUENCY_RAD_PER_S[0]), Math.log(FREQUENCY_RAD_PER_S[1]));
    const ratio = slider(`Damping ratio of axis ${axis} of ${task.name}`, 0, 2);
    const [frequencyText, ratioText] = [make("output"), make("output")];
    const send = () => {
      const [natural_frequency_rad_per_s, damping_ratio] = [Math.exp(Number(frequency.value)), Number(ratio.value)];
      write(natural_frequency_rad_per_s, damping_ratio);
      control({ op: "gains", task: task.name, axis, natural_frequency_rad_per_s, damping_ratio });
    };
    const write = (frequency_rad_per_s: number, damping_ratio: number) => {
      setText(frequencyText, `${frequency_rad_per_s.toPrecision(3)} rad/s`);
      setText(ratioText, `ζ ${damping_ratio.toFixed(2)}`);
    };
    let held_until_ms = 0;
    for (const input of [frequency, ratio]) {
      input.oninput = () => {
        // The state that arrives meanwhile is older.
        held_until_ms = performance.now() + 600;
        send();
      };
    }
    element.append(make("label", {}, frequency, frequencyText), make("label", {}, ratio, ratioText));
    shows.push(task => {
      const value = task.gains?.[axis];
      if (!value || performance.now() < held_until_ms) return;
      frequency.value = `${Math.log(value.natural_frequency_rad_per_s)}`;
      ratio.value = `${value.damping_ratio}`;
      write(value.natural_frequency_rad_per_s, value.damping_ratio);
    });
  }
  return { element, row: { show: task => shows.forEach(show => show(task)) } };
}

function slider(name: string, min: number, max: number): HTMLInputElement {
  return make("input", { type: "range", min: `${min}`, max: `${max}`, step: "any", "aria-label": name });
}
