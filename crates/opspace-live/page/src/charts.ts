//! Plots of the run: force over displacement of the pushed frame, and chosen signals over time on one cursor.

import { make } from "./dom.ts";
import { Plot, type Line } from "./plot.ts";
import { controlledPosition, shownName, type RobotState, type Signals } from "./state.ts";
import { comparedColor, css } from "./theme.ts";

/** Time that the plots show of a running simulation, and that is kept, s. */
const SHOWN_S = 10;
const KEPT_S = 120;
const MOST_SIGNALS = 8;
const COLORS = ["#2a8fd0", "#e07b2a", "#1f9e78", "#c46bb0", "#b09a1e", "#7f8b97", "#d4504c", "#5b6fd6"];
const FORCE_COLOR = "#c46bb0";
const AXES = ["x", "y", "z"] as const;
/** Points of a curve of force over displacement. */
const MOST_POINTS = 4000;

interface History {
  label: string;
  time_s: number[];
  values: Map<string, number[]>;
}

export class Charts {
  readonly element: HTMLElement;
  private readonly histories = new Map<string, History>();
  private readonly plots = make("div", { className: "plots" });
  private readonly picker = make("input", { type: "search", placeholder: "Add a signal…", "aria-label": "Add a signal to the plots" });
  private readonly names = make("datalist", { id: "signals" });
  private readonly chips = make("ul", { className: "chips", "aria-label": "Signals that are plotted" });
  private readonly axis = make("select", { "aria-label": "Axis of force and displacement" });
  private readonly forcePlot = new Plot(180);
  private byUnit = new Map<string, Plot>();
  private chosen: string[] = [];
  private isChosen = false;
  private units: Record<string, string> = {};
  private cursor_s: number | undefined;
  private curves = new Map<string, Line[]>();
  private origins = new Map<string, [number, number, number]>();
  private isDirty = false;
  private range: [number, number] = [0, SHOWN_S];
  private isLog = false;

  constructor() {
    this.picker.setAttribute("list", "signals");
    this.picker.oninput = () => this.choose(this.picker.value);
    AXES.forEach(axis => this.axis.add(new Option(axis)));
    this.axis.onchange = () => (this.isDirty = true);
    const heading = make("h2", {}, "Force over displacement ", this.axis);
    this.element = make(
      "section",
      { className: "charts" },
      heading,
      this.forcePlot.element,
      make("h2", {}, "Signals"),
      make("div", { className: "picker" }, this.picker, this.names),
      this.chips,
      this.plots,
    );
  }

  setRobots(robots: RobotState[], kind: "run" | "log", duration_s: number): void {
    this.isLog = kind === "log";
    if (this.isLog) this.range = [0, duration_s];
    robots.forEach(robot => {
      const { prefix, units } = robot;
      const history = this.histories.get(prefix) ?? { label: "", time_s: [], values: new Map() };
      history.label = robots.length > 1 ? shownName(robot, true) : "";
      this.histories.set(prefix, history);
      Object.assign(this.units, units);
    });
  }

  /** Forgets all: the run begins again. */
  clear(): void {
    for (const history of this.histories.values()) {
      history.time_s = [];
      history.values.clear();
    }
    this.curves.clear();
    this.origins.clear();
    this.isDirty = true;
  }

  add(prefix: string, { time_s, values }: Signals): void {
    const history = this.histories.get(prefix);
    if (!history) return;
    const last_s = history.time_s.at(-1) ?? -Infinity;
    if (time_s < last_s - 1e-9) {
      // A log was moved back: what follows is drawn again.
      const kept = history.time_s.findIndex(t => t >= time_s);
      history.time_s.length = kept;
      history.values.forEach(column => (column.length = Math.min(column.length, kept)));
    } else if (time_s <= last_s) return;
    const count = history.time_s.push(time_s);
    for (const [name, value] of Object.entries(values)) {
      let column = history.values.get(name);
      if (!column) {
        column = new Array(count - 1).fill(NaN);
        history.values.set(name, column);
      }
      while (column.length < count - 1) column.push(NaN);
      column.push(value);
    }
    if (!this.isLog && time_s - history.time_s[0]! > KEPT_S) {
      const first = history.time_s.findIndex(t => t > time_s - 0.8 * KEPT_S);
      history.time_s.splice(0, first);
      history.values.forEach(column => column.splice(0, first));
    }
    if (!this.isLog) this.range = [Math.max(0, time_s - SHOWN_S), Math.max(SHOWN_S, time_s)];
    if (!this.isChosen) this.chooseDefaults();
    this.isDirty = true;
  }

  /** Adds a point to the curves of a robot: position of the pushed frame (m), and force on it (N). */
  addForce(prefix: string, position_m: [number, number, number], force_n: [number, number, number], isHeld: boolean): void {
    if (!isHeld) return;
    const origin = this.origins.get(prefix) ?? position_m;
    this.origins.set(prefix, origin);
    const curves = this.curves.get(prefix) ?? AXES.map(label => ({ label, color: "", x: [], y: [] }));
    this.curves.set(prefix, curves);
    curves.forEach((curve, i) => {
      curve.x.push(1e3 * (position_m[i]! - origin[i]!));
      curve.y.push(force_n[i]!);
      if (curve.x.length > MOST_POINTS) {
        curve.x.shift();
        curve.y.shift();
      }
    });
    this.isDirty = true;
  }

  /** A new pull begins: displacements are from where the frame is then. */
  beginPull(): void {
    this.curves.clear();
    this.origins.clear();
  }

  choose(name: string): void {
    if (!this.allNames().includes(name)) return;
    this.picker.value = "";
    if (!this.chosen.includes(name)) this.chosen = [...this.chosen, name].slice(-MOST_SIGNALS);
    this.isDirty = true;
    this.writeChips();
  }

  draw(now_s: number): void {
    if (!this.isDirty) return;
    this.isDirty = false;
    const several = this.histories.size > 1;
    const i = AXES.indexOf(this.axis.value as "x");
    const lines = [...this.curves].map(([prefix, curves]) => ({
      ...curves[i]!,
      label: several ? this.histories.get(prefix)?.label || prefix : "",
      color: several ? css(comparedColor([...this.histories.keys()].indexOf(prefix))) : FORCE_COLOR,
    }));
    this.forcePlot.draw({
      title: `force ${this.axis.value} (N)`,
      xLabel: `displacement ${this.axis.value} (mm)`,
      lines,
      hasHead: true,
    });
    this.drawSignals(several, now_s);
  }

  private drawSignals(several: boolean, now_s: number): void {
    const groups = new Map<string, string[]>();
    for (const name of this.chosen) {
      const unit = this.units[name] ?? "";
      groups.set(unit, [...(groups.get(unit) ?? []), name]);
    }
    for (const [unit, plot] of this.byUnit) {
      if (groups.has(unit)) continue;
      plot.element.remove();
      this.byUnit.delete(unit);
    }
    for (const [unit, names] of groups) {
      let plot = this.byUnit.get(unit);
      if (!plot) {
        plot = new Plot(150, time_s => {
          this.cursor_s = time_s;
          this.isDirty = true;
        });
        this.byUnit.set(unit, plot);
        this.plots.append(plot.element);
      }
      const lines = names.flatMap(name =>
        [...this.histories.values()].map((history, robot): Line => {
          const color = several && names.length === 1 ? css(comparedColor(robot)) : COLORS[(this.chosen.indexOf(name) + 3 * robot) % COLORS.length]!;
          const first = this.isLog ? 0 : Math.max(0, history.time_s.findIndex(t => t >= this.range[0]));
          // The legend of one signal of several robots names these; the chip above names the signal.
          const label = history.label ? (names.length === 1 ? history.label : `${name} ${history.label}`) : name;
          return { label, color, x: history.time_s.slice(first), y: history.values.get(name)?.slice(first) ?? [] };
        }),
      );
      const cursor = this.cursor_s ?? (this.isLog ? now_s : undefined);
      plot.draw({ title: several && names.length === 1 ? `${names[0]} (${unit || "1"})` : unit || "1", xLabel: "time (s)", lines, xRange: this.range, cursor });
    }
  }

  private allNames(): string[] {
    return [...new Set([...this.histories.values()].flatMap(history => [...history.values.keys()]))];
  }

  /** The errors of the first task, or its position. */
  private chooseDefaults(): void {
    const names = this.allNames();
    if (names.length === 0) return;
    this.isChosen = true;
    this.names.replaceChildren(...names.map(name => make("option", { value: name })));
    const of = (pattern: RegExp) => names.filter(name => pattern.test(name)).slice(0, 3);
    const positions = [controlledPosition(this.units) ?? ""].filter(name => name !== "").flatMap(name => AXES.map(axis => name.replace(/x$/, axis)));
    const forces = of(/\.force\.x/).slice(0, 1);
    // Several robots have a line each.
    const most = this.histories.size > 1 ? 1 : 3;
    this.chosen = [...positions.filter(name => names.includes(name)).slice(0, most), ...forces];
    if (this.chosen.length === 0) this.chosen = names.filter(name => name.startsWith("q.")).slice(0, 4);
    this.writeChips();
  }

  private writeChips(): void {
    const chip = (name: string) => {
      const remove = make("button", { type: "button", "aria-label": `Remove ${name}`, title: `Remove ${name}` }, "×");
      remove.onclick = () => {
        this.chosen = this.chosen.filter(other => other !== name);
        this.isDirty = true;
        this.writeChips();
      };
      return make("li", {}, name, remove);
    };
    this.chips.replaceChildren(...this.chosen.map(chip));
  }
}
