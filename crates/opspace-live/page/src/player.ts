//! Player of a run in a report. Without scripts or WebGL it stays hidden, and the figure shows its still views.

import { Vector3 } from "three";
import type { RunsData } from "./run_data.ts";
import { RunScene, type RunRobot } from "./run_scene.ts";
import { Stage } from "./stage.ts";
import { SCENE_STYLE } from "./style.ts";
import { comparedColor, css } from "./theme.ts";
import { iconButton, make, setIcon } from "./dom.ts";
import { ICONS } from "./icons.ts";

const STYLE = `
.player { --label: var(--ink) }
.player .stage { position: relative; aspect-ratio: 2 / 1; min-height: 18rem; width: 100%; border: 1px solid var(--line); border-radius: 10px;
  overflow: hidden; background: linear-gradient(#fbfcfd, #eef1f4) }
.player .stage canvas { touch-action: pan-y }
.player .bar { display: flex; align-items: center; gap: 0.6rem; margin: 0.5rem 0 1.2rem; font-size: 0.9rem; color: var(--soft) }
.player .bar button, .player .bar select { font: inherit; color: var(--ink); background: var(--back); border: 1px solid var(--line);
  border-radius: 6px; height: 2.2rem; cursor: pointer }
.player .bar button { display: inline-grid; place-items: center; min-width: 2.4rem; padding: 0 0.5rem }
.player .bar button:hover, .player .bar select:hover { border-color: var(--soft) }
.player .bar button[aria-pressed=false] { color: var(--soft); opacity: 0.6 }
.player .bar svg { width: 1.1rem; height: 1.1rem; min-width: 0; display: block }
.player .bar input { flex: 1; min-width: 4rem; accent-color: #0072b2 }
.player .bar output { font-variant-numeric: tabular-nums; white-space: nowrap }
.player .robots { list-style: none; display: flex; flex-wrap: wrap; gap: 0.1rem 1rem; margin: 0.4rem 0 0; padding: 0; color: var(--soft) }
.player .robots li::before { content: ''; display: inline-block; width: 0.8em; height: 0.8em; border-radius: 50%; background: var(--color);
  margin-right: 0.45em }
@media (pointer: coarse) {
  .player .bar button, .player .bar select, .player .bar input { height: 2.6rem }
  .player .bar button { min-width: 2.6rem }
}
@media screen and (prefers-color-scheme: dark) { .player .stage { background: linear-gradient(#1d2125, #121416) } }
@media print { .player { display: none } }
${SCENE_STYLE}`;

const SPEEDS = [0.1, 0.25, 0.5, 1, 2];

class Player {
  private readonly play = iconButton("Play", ICONS.play, () => this.toggle());
  private readonly loop = iconButton("Loop", ICONS.loop, () => {
    this.isLooped = !this.isLooped;
    this.update();
  });
  private readonly slider = document.createElement("input");
  private readonly clock = document.createElement("output");
  private readonly speed = document.createElement("select");
  private now_s: number;
  private isPlaying = false;
  private isLooped = true;

  constructor(place: HTMLElement, private readonly stage: Stage, private readonly scene: RunScene) {
    this.now_s = scene.start_s;
    Object.assign(this.slider, { type: "range", min: `${scene.start_s}`, max: `${scene.end_s}`, step: "any", value: `${scene.start_s}` });
    this.slider.setAttribute("aria-label", "Time of the picture");
    this.slider.addEventListener("input", () => {
      this.isPlaying = false;
      this.seek(Number(this.slider.value));
    });
    this.speed.setAttribute("aria-label", "Speed");
    for (const speed of SPEEDS) this.speed.add(new Option(`${speed} ×`, `${speed}`, speed === 1, speed === 1));
    const bar = document.createElement("div");
    bar.className = "bar";
    bar.append(this.play, this.slider, this.clock, this.speed, this.loop);
    if (scene.robots.length > 1) place.append(legend(scene));
    place.append(bar);
    stage.beforeDraw = dt_s => this.advance(dt_s);
    this.seek(scene.start_s);
  }

  get time_s(): number {
    return this.now_s;
  }

  get playing(): boolean {
    return this.isPlaying;
  }

  seek(time_s: number): void {
    this.now_s = Math.min(this.scene.end_s, Math.max(this.scene.start_s, time_s));
    this.scene.show(this.now_s);
    this.update();
  }

  toggle(): void {
    this.isPlaying = !this.isPlaying;
    if (this.isPlaying && this.now_s >= this.scene.end_s) this.now_s = this.scene.start_s;
    this.update();
    this.stage.request();
  }

  private advance(dt_s: number): void {
    if (!this.isPlaying) return;
    let time_s = this.now_s + dt_s * Number(this.speed.value);
    if (time_s >= this.scene.end_s) {
      if (this.isLooped) time_s = this.scene.start_s;
      else this.isPlaying = false;
    }
    this.seek(time_s);
  }

  private update(): void {
    this.stage.isMoving = this.isPlaying;
    this.slider.value = `${this.now_s}`;
    this.clock.textContent = `${this.time_s.toFixed(2)} s`;
    setIcon(this.play, this.isPlaying ? "Pause" : "Play", this.isPlaying ? ICONS.pause : ICONS.play);
    this.loop.setAttribute("aria-pressed", `${this.isLooped}`);
  }
}

/** Colours and names of the robots. */
function legend(scene: RunScene): HTMLElement {
  const item = ({ robot, data }: RunRobot) => {
    const item = make("li", {}, [data.name, robot.apart].filter(Boolean).join(": "));
    item.style.setProperty("--color", css(robot.color ?? comparedColor(0)));
    return item;
  };
  return make("ul", { className: "robots", "aria-label": "Robots" }, ...scene.robots.map(item));
}

function start(): void {
  const place = document.querySelector<HTMLElement>(".player");
  const text = document.getElementById("player-data")?.textContent;
  if (!place || !text) return;
  const container = document.createElement("div");
  container.className = "stage";
  place.append(container);
  place.hidden = false;
  const style = document.createElement("style");
  style.textContent = STYLE;
  document.head.append(style);
  const stage = Stage.in(container);
  if (!stage) {
    place.hidden = true;
    return;
  }
  // A page is scrolled by the wheel.
  stage.canvas.dataset["wheel"] = "page";
  stage.canvas.tabIndex = 0;
  stage.canvas.setAttribute("role", "img");
  stage.canvas.setAttribute("aria-label", "Moving picture of the run: drag to orbit, space to play or pause");
  const scene = new RunScene(stage, JSON.parse(text) as RunsData);
  const player = new Player(place, stage, scene);
  const robot = (name: string) => scene.robots.find(({ data }) => data.name === name) ?? scene.robots[0]!;
  stage.canvas.addEventListener("keydown", event => {
    const turns: Record<string, [number, number]> = {
      ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1],
    };
    const turn = turns[event.key];
    if (event.key === " ") player.toggle();
    else if (turn) stage.orbit.turn(...turn);
    else return;
    event.preventDefault();
  });
  Object.assign(window, {
    opspaceView: {
      robots: () => scene.robots.map(({ data }) => data.name),
      pixel: (frame: string, name = "") => stage.pixel(robot(name).robot.drawnAt(robot(name).robot.position(frame))),
      frames: (name = "") => robot(name).frames(),
      drawn: () => stage.drawn,
      time_s: () => player.time_s,
      seek: (time_s: number) => player.seek(time_s),
      toggle: () => player.toggle(),
      drawFinely: () => stage.drawFinely(),
      frame: () => scene.frame(),
      zoom: (factor: number) => stage.orbit.zoom(factor),
      isPlaying: () => player.playing,
      orbit: (azimuth_rad: number, elevation_rad: number) => stage.orbit.turn(azimuth_rad, elevation_rad),
      lookFrom: (azimuth_rad: number, elevation_rad: number) => stage.orbit.lookFrom(azimuth_rad, elevation_rad),
      pixelOf: (point: [number, number, number]) => stage.pixel(new Vector3(...point)),
    },
  });
}

start();
