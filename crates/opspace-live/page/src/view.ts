//! Live page: scene, hand, controls and plots of a running simulation, or of a log.

import { Vector3 } from "three";
import { Charts } from "./charts.ts";
import { Connection } from "./connection.ts";
import { iconButton, make, setText } from "./dom.ts";
import { Hand } from "./hand.ts";
import { ICONS } from "./icons.ts";
import { LiveScene } from "./live_scene.ts";
import { Stage } from "./stage.ts";
import { SCENE_STYLE } from "./style.ts";
import { controlledPosition, shownName, type RobotState, type Signals, type ViewState } from "./state.ts";
import { comparedColor, css } from "./theme.ts";
import { Transport } from "./transport.ts";
import { Tuning } from "./tuning.ts";

/** Time over which pictures are counted, ms. */
const RATE_MS = 2000;
/** A message that the user should notice is shown for this long, ms. */
const NOTICE_MS = 6000;
/** Time between two updates of clock and state, and of the plots, ms. */
const STATE_MS = 150;
const PLOT_MS = 200;
/** Step of the arrow keys in a log, s. */
const SEEK_S = 0.1;

const $ = <T extends HTMLElement>(id: string) => document.getElementById(id) as T;

function start(): void {
  document.head.append(make("style", {}, SCENE_STYLE));
  const stage = Stage.in($("stage"));
  if (!stage) {
    $("stage").append(make("p", { className: "message" }, "This browser draws no WebGL: the scene cannot be shown."));
    return;
  }
  new View(stage);
}

class View {
  private readonly scene: LiveScene;
  private readonly hand: Hand;
  private readonly connection: Connection;
  private readonly transport = new Transport(message => this.connection.publish("/control", message));
  private readonly tuning = new Tuning(message => this.connection.publish("/control", message));
  private readonly charts = new Charts();
  private state: ViewState | undefined;
  /** Messages that came before the state of the view named the robots. */
  private early: [string, string, Uint8Array][] = [];
  private pictures: number[] = [];
  private pictureCount = 0;
  private hasPicture = false;
  private wasHolding = false;
  private isConnected = false;
  private notice = 0;
  private last_s = 0;
  private shownState = "";
  private shownAt_ms = 0;

  constructor(private readonly stage: Stage) {
    this.scene = new LiveScene(stage);
    stage.canvas.tabIndex = 0;
    stage.canvas.setAttribute("role", "application");
    stage.canvas.setAttribute("aria-label", "Scene: drag to orbit, double-click a link to select it, drag with Ctrl to pull it");
    $("bar").append(this.transport.element);
    $("panel").append(this.tuning.element, this.charts.element);
    const url = new URL(location.href);
    url.protocol = url.protocol.replace("http", "ws");
    url.hash = "";
    this.connection = new Connection(url.href, ["/hand", "/control"], {
      message: (topic, schema, payload) => this.message(topic, schema, payload),
      connected: isConnected => this.connected(isConnected),
      status: text => this.say(text),
    });
    this.hand = new Hand(
      stage,
      () => (this.state?.robots ?? []).filter(robot => robot.can_push).flatMap(({ prefix }) => this.scene.robots.get(prefix) ?? []),
      message => this.connection.hold("/hand", message),
      message => this.connection.publish("/hand", message),
    );
    this.hand.onSelect = () => this.writeHand();
    stage.beforeDraw = () => this.beforeDraw();
    // Plots are drawn less often than the scene: their lines move by less than a pixel.
    setInterval(() => this.charts.draw(this.state?.time_s ?? 0), PLOT_MS);
    setInterval(() => this.state && this.transport.show(this.state, this.pictures_hz), 500);
    this.addKeys();
    Object.assign(window, { opspaceView: this.probe() });
  }

  private get pictures_hz(): number {
    const from = performance.now() - RATE_MS;
    this.pictures = this.pictures.filter(time => time > from);
    return (1e3 * this.pictures.length) / RATE_MS;
  }

  private message(topic: string, schema: string, payload: Uint8Array): void {
    if (topic === "/view") {
      this.setState(JSON.parse(new TextDecoder().decode(payload)) as ViewState);
      return;
    }
    if (!this.state) {
      this.early.push([topic, schema, payload]);
      return;
    }
    const [robot, name] = this.scene.owner(topic);
    if (robot && name === "/signals") {
      this.signals(robot.prefix, JSON.parse(new TextDecoder().decode(payload)) as Signals);
    } else if (this.scene.message(topic, schema, payload) && name === "/tf") {
      this.hasPicture = true;
    }
  }

  private setState(state: ViewState): void {
    // A run that begins again, or a log that is moved back.
    if (state.time_s < this.last_s - 0.05) {
      this.scene.clearTrails();
      if (state.kind === "run") this.charts.clear();
    }
    this.last_s = state.time_s;
    this.state = state;
    this.stage.isMoving = state.state === "playing";
    document.title = `${state.title} – opspace`;
    this.scene.setRobots(state.robots);
    this.charts.setRobots(state.robots, state.kind, state.duration_s);
    this.early.splice(0).forEach(([topic, schema, payload]) => this.message(topic, schema, payload));
    this.tuning.show(state.kind === "run" ? state.robots : []);
    // What changes with each picture is written a few times a second: the layout of the page is not for free.
    const key = `${state.state} ${state.speed} ${state.kind} ${state.outcome}`;
    const isHeld = this.wasHolding || state.robots.some(robot => robot.hand);
    // The state is repeated while nothing changes, and the picture that stays is a fine one.
    if (key !== this.shownState || isHeld) this.stage.request();
    if (key !== this.shownState || performance.now() - this.shownAt_ms > STATE_MS) {
      this.shownState = key;
      this.shownAt_ms = performance.now();
      this.transport.show(state, this.pictures_hz);
    }
    this.hand.force_n = this.hand.isHolding ? norm(state.robots.find(robot => robot.hand)?.hand?.force_n) : undefined;
    this.addForces(state);
    this.writeTitle(state);
    this.writeHand();
  }

  private signals(prefix: string, signals: Signals): void {
    this.charts.add(prefix, signals);
    if (this.state && signals.time_s > this.state.time_s) this.state.time_s = signals.time_s;
    // Without a hand, the forces of the environment on the first controlled frame.
    if (this.state?.robots.some(robot => robot.hand)) return;
    // Before control, tasks have no positions yet.
    if (signals.values["phase"] === 0) return;
    const force = triple(signals.values, /^(?!.*wrench)[^.]+\.force\.x(_n)?$/);
    const units = this.state?.robots.find(robot => robot.prefix === prefix)?.units ?? {};
    const name = controlledPosition(units);
    const position = name === undefined ? undefined : elements(signals.values, name);
    if (force && position) this.charts.addForce(prefix, position, force, !this.hand.isHolding);
  }

  private addForces(state: ViewState): void {
    const isHolding = state.robots.some(robot => robot.hand);
    if (isHolding && !this.wasHolding) this.charts.beginPull();
    this.wasHolding = isHolding;
    for (const { prefix, hand } of state.robots) {
      const robot = this.scene.robots.get(prefix);
      if (hand && robot) this.charts.addForce(prefix, robot.position(hand.frame).toArray(), hand.force_n, true);
    }
  }

  private beforeDraw(): void {
    this.hand.draw();
    if (!this.hasPicture) return;
    this.hasPicture = false;
    this.pictures.push(performance.now());
    this.pictureCount += 1;
  }

  private connected(isConnected: boolean): void {
    if (!isConnected) this.hand.release();
    this.isConnected = isConnected;
    document.body.classList.toggle("lost", !isConnected);
    $("lost").hidden = isConnected;
    setText($("lost"), this.state ? "The connection is lost: the picture stands still. Trying again…" : "Waiting for the program…");
  }

  private say(text: string): void {
    setText($("notice"), text);
    $("notice").hidden = false;
    clearTimeout(this.notice);
    this.notice = setTimeout(() => ($("notice").hidden = true), NOTICE_MS);
  }

  private writeTitle(state: ViewState): void {
    setText($("title"), state.title);
    const several = state.robots.length > 1;
    const name = (robot: RobotState) => [shownName(robot, several), this.scene.robots.get(robot.prefix)?.apart].filter(Boolean).join(": ");
    const items = state.robots.map(name).join("|");
    const legend = $("legend");
    if (legend.dataset["text"] === items) return;
    legend.dataset["text"] = items;
    legend.replaceChildren(
      ...state.robots.map((robot, i) => {
        const item = make("li", { className: several ? "compared" : "" }, name(robot));
        item.style.setProperty("--color", css(comparedColor(i)));
        return item;
      }),
    );
  }

  private writeHand(): void {
    const robots = this.state?.robots ?? [];
    const canPush = robots.some(robot => robot.can_push);
    const holding = robots.find(robot => robot.hand);
    const hint = $("hint");
    const isTouch = matchMedia("(pointer: coarse)").matches;
    if (!canPush) setText(hint, this.state ? (this.state.kind === "log" ? "A log: drag the time to see any moment." : "Only watched: this robot is not pushed from here.") : "");
    else if (this.state?.state === "ended") setText(hint, "The run is over: play begins a new one.");
    else if (holding?.hand) {
      const { frame, stiffness_n_per_m, largest_force_n } = holding.hand;
      setText(hint, `Pulls ${frame} with ${norm(holding.hand.force_n)!.toFixed(1)} N: ${stiffness_n_per_m} N/m, at most ${largest_force_n} N`);
    } else if (this.hand.selected) {
      setText(hint, `${this.hand.selected} is selected: ${isTouch ? "drag it" : "drag with Ctrl"} to pull`);
    } else setText(hint, isTouch ? "Tap a link twice, then drag it to pull" : "Drag a link with Ctrl to pull it");
    hint.classList.toggle("active", !!holding);
  }

  private addKeys(): void {
    const help = $<HTMLDialogElement>("help");
    const showHelp = () => (help.open ? help.close() : help.showModal());
    const panel = () => {
      document.body.classList.toggle("no-panel");
      this.stage.request();
    };
    $("tools").append(
      iconButton("Show the whole robot (f)", ICONS.frame, () => this.scene.show()),
      iconButton("Plots and gains (p)", ICONS.panel, panel),
      iconButton("Help (?)", ICONS.help, showHelp),
    );
    const keys: Record<string, () => void> = {
      " ": () => this.transport.toggle(),
      r: () => this.transport.restart(),
      ".": () => this.transport.step(),
      f: () => this.scene.show(),
      p: panel,
      "?": showHelp,
      Escape: () => this.hand.selectFrame(undefined, ""),
      ArrowLeft: () => this.transport.seekBy(-SEEK_S),
      ArrowRight: () => this.transport.seekBy(SEEK_S),
    };
    addEventListener("keydown", event => {
      // Fields and sliders keep their keys, and the browser its own.
      const target = event.target instanceof Element ? event.target : document.body;
      if (target.closest("input, select, dialog") || event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === " " && target.closest("button")) return;
      if (event.key.startsWith("Arrow") && this.state?.kind !== "log") {
        const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
        if (turn) this.stage.orbit.turn(turn[0]!, turn[1]!);
        return;
      }
      const action = keys[event.key];
      if (!action) return;
      action();
      event.preventDefault();
    });
  }

  /** For tests. */
  private probe(): Record<string, unknown> {
    const robot = (prefix: string) => this.scene.robots.get(prefix);
    return {
      isConnected: () => this.isConnected,
      picturesPerSecond: () => this.pictures_hz,
      /** Number of pictures of the moving robots since the page was opened. */
      pictures: () => this.pictureCount,
      drawn: () => this.stage.drawn,
      time_s: () => this.state?.time_s ?? NaN,
      state: () => this.state,
      handForce_n: () => (this.state?.robots ?? []).map(robot => robot.hand?.force_n ?? null),
      isHolding: () => this.hand.isHolding,
      selected: () => this.hand.selected,
      select: (frame: string, prefix = [...this.scene.robots.keys()][0] ?? "") => this.hand.selectFrame(robot(prefix), frame),
      frames: (prefix = "") => {
        const names = robot(prefix)?.frameNames() ?? [];
        return Object.fromEntries(names.map(name => [name, robot(prefix)!.position(name).toArray()]));
      },
      pixel: (frame: string, prefix = "") => {
        const shown = robot(prefix);
        return shown && this.stage.pixel(shown.drawnAt(shown.position(frame)));
      },
      /** Pixel of a point in the world of a robot, m. */
      pixelOf: (point: [number, number, number], prefix = [...this.scene.robots.keys()][0] ?? "") =>
        this.stage.pixel(robot(prefix)?.drawnAt(new Vector3(...point)) ?? new Vector3(...point)),
      orbit: (azimuth_rad: number, elevation_rad: number) => this.stage.orbit.turn(azimuth_rad, elevation_rad),
      lookFrom: (azimuth_rad: number, elevation_rad: number) => this.stage.orbit.lookFrom(azimuth_rad, elevation_rad),
    };
  }
}

function norm(vector: number[] | undefined): number | undefined {
  return vector && Math.hypot(...vector);
}

/** Values of the signal whose element x has this name. */
function triple(values: Record<string, number>, pattern: RegExp): [number, number, number] | undefined {
  const x = Object.keys(values).find(name => pattern.test(name));
  return x === undefined ? undefined : elements(values, x);
}

/** Values of the signal whose element x has this name; none if one is absent. */
function elements(values: Record<string, number>, x: string): [number, number, number] | undefined {
  const of = (axis: string) => values[x.replace(/x(_\w+)?$/, `${axis}$1`)];
  const [a, b, c] = [of("x"), of("y"), of("z")];
  return a === undefined || b === undefined || c === undefined ? undefined : [a, b, c];
}

start();
