//! Bar with play, pause, step, restart, speed, time, and the state of the run.

import { iconButton, make, setIcon, setText } from "./dom.ts";
import { ICONS } from "./icons.ts";
import type { ViewState } from "./state.ts";

const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4];

export class Transport {
  readonly element: HTMLElement;
  private readonly play = iconButton("Pause", ICONS.pause, () => this.toggle());
  private readonly stepButton = iconButton("Step one cycle", ICONS.step, () => this.step());
  private readonly slider = make("input", { type: "range", min: "0", step: "any", value: "0", "aria-label": "Time" });
  private readonly clock = make("output", { className: "clock" });
  private readonly speed = make("select", { "aria-label": "Speed" });
  private readonly facts = make("ul", { className: "facts", "aria-label": "State of the run" });
  private state: ViewState | undefined;
  private isSeeking = false;

  constructor(private readonly control: (message: Record<string, unknown>) => void) {
    for (const speed of SPEEDS) this.speed.add(new Option(`${speed} ×`, `${speed}`, speed === 1, speed === 1));
    this.speed.onchange = () => control({ op: "speed", value: Number(this.speed.value) });
    this.slider.oninput = () => {
      this.isSeeking = true;
      control({ op: "seek", time_s: Number(this.slider.value) });
    };
    this.slider.onchange = () => (this.isSeeking = false);
    const restart = iconButton("Restart", ICONS.restart, () => this.restart());
    const buttons = make("div", { className: "buttons" }, restart, this.play, this.stepButton);
    this.element = make("div", { className: "transport" }, buttons, this.slider, this.clock, this.speed, this.facts);
  }

  toggle(): void {
    if (this.state?.state === "ended") this.restart();
    else this.control({ op: this.state?.state === "playing" ? "pause" : "play" });
  }

  restart(): void {
    this.control({ op: "restart" });
  }

  step(): void {
    if (this.state?.state === "playing") this.control({ op: "pause" });
    this.control({ op: "step" });
  }

  /** Moves the time of a log by some seconds. */
  seekBy(seconds: number): void {
    if (this.state?.kind !== "log") return;
    const time_s = Math.min(this.state.duration_s, Math.max(0, this.state.time_s + seconds));
    this.control({ op: "seek", time_s });
  }

  show(state: ViewState, pictures_hz: number): void {
    this.state = state;
    const isPlaying = state.state === "playing";
    if (state.state === "ended") setIcon(this.play, "Play again", ICONS.play);
    else setIcon(this.play, isPlaying ? "Pause" : "Play", isPlaying ? ICONS.pause : ICONS.play);
    this.stepButton.disabled = state.state === "ended";
    this.slider.max = `${state.duration_s}`;
    // The time of a simulation goes only forwards.
    this.slider.disabled = state.kind !== "log";
    if (!this.isSeeking) this.slider.value = `${state.time_s}`;
    this.slider.style.setProperty("--share", `${(100 * state.time_s) / Math.max(1e-9, state.duration_s)}%`);
    setText(this.clock, `${Math.max(0, state.time_s).toFixed(2)} / ${state.duration_s.toFixed(1)} s`);
    if (document.activeElement !== this.speed) {
      if (![...this.speed.options].some(option => Number(option.value) === state.speed)) {
        this.speed.add(new Option(`${state.speed} ×`, `${state.speed}`));
      }
      this.speed.value = `${state.speed}`;
    }
    const facts: [string, string, string][] = [];
    if (state.outcome) facts.push(["outcome", state.outcome, state.outcome === "completed" ? "good" : "bad"]);
    facts.push(["pictures/s", `${Math.round(pictures_hz)}`, ""]);
    if (state.kind === "run") facts.push(["late cycles", `${state.late_cycles}`, state.late_cycles > 0 ? "warn" : ""]);
    facts.push(["dropped pictures", `${state.dropped_pictures}`, ""]);
    const text = facts.flat().join("|");
    if (this.facts.dataset["text"] === text) return;
    this.facts.dataset["text"] = text;
    this.facts.replaceChildren(
      ...facts.map(([term, value, kind]) =>
        term === "outcome" ? make("li", { className: kind }, value) : make("li", { className: kind }, `${term} `, make("b", {}, value)),
      ),
    );
  }
}
