//! Hand: a spring between a point of a link and the pointer. Gestures of MuJoCo and Gazebo: a double-click selects a link; a drag with Ctrl
//! pulls it. On a touch screen, a drag that begins on the selected link pulls it.

import { Plane, Raycaster, Vector2, Vector3 } from "three";
import type { Robot } from "./robot.ts";
import { HandSpring } from "./robot.ts";
import { SOLID, type Stage } from "./stage.ts";

/** Time between two orders while the hand holds, ms. Between them the connection repeats the message: the program lets go 50 ms after the
 * last one. */
const REPEAT_MS = 50;
/** Until the program has stated the spring, N/m and N. */
const STIFFNESS_N_PER_M = 300;

interface Grasp {
  pointer: number;
  robot: Robot;
  frame: string;
  /** In the frame of the link, m. */
  point: Vector3;
  /** In the scene, m. */
  target: Vector3;
  /** The pointer moves in the plane through the point that faces the camera. */
  plane: Plane;
}

export class Hand {
  private grasp: Grasp | undefined;
  private selection: { robot: Robot; frame: string } | undefined;
  private readonly spring: HandSpring;
  private readonly ray = new Raycaster();
  private timer = 0;
  private force: number | undefined;
  /** Called with the name of the selected link; "" if there is none. */
  onSelect: (frame: string) => void = () => {};

  constructor(
    private readonly stage: Stage,
    /** Robots that can be pushed. */
    private readonly robots: () => Robot[],
    /** Publishes a message until the next call; none if undefined. */
    private readonly hold: (message: unknown) => void,
    private readonly publish: (message: unknown) => void,
  ) {
    this.spring = new HandSpring(stage);
    this.ray.layers.set(SOLID);
    const canvas = stage.canvas;
    canvas.addEventListener("dblclick", event => this.select(event));
    // Before the camera sees the pointer.
    canvas.addEventListener("pointerdown", event => this.begin(event), { capture: true });
    canvas.addEventListener("pointermove", event => this.move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      canvas.addEventListener(kind, event => {
        if (event.pointerId === this.grasp?.pointer) this.release();
      });
    }
    addEventListener("blur", () => this.release());
    document.addEventListener("visibilitychange", () => document.hidden && this.release());
  }

  /** Force of the hand as the program computes it, N. */
  set force_n(force: number | undefined) {
    this.force = force;
  }

  get force_n(): number {
    if (!this.grasp) return 0;
    return this.force ?? STIFFNESS_N_PER_M * this.from().distanceTo(this.grasp.target);
  }

  get isHolding(): boolean {
    return this.grasp !== undefined;
  }

  get selected(): string {
    return this.selection?.frame ?? "";
  }

  /** Draws the spring where link and pointer are now. */
  draw(): void {
    if (this.grasp) this.spring.set(this.from(), this.grasp.target, this.force_n);
  }

  release(): void {
    if (!this.grasp) return;
    this.grasp = undefined;
    this.force = undefined;
    clearInterval(this.timer);
    this.stage.orbit.enabled = true;
    this.spring.hide();
    this.hold(undefined);
    this.publish({ release: true });
  }

  /** Selects a link by its name, as a double-click does. */
  selectFrame(robot: Robot | undefined, frame: string): void {
    this.selection?.robot.select("");
    this.selection = robot && frame ? { robot, frame } : undefined;
    this.selection?.robot.select(frame);
    this.onSelect(this.selected);
  }

  private select(event: MouseEvent): void {
    const hit = this.hit(event);
    this.selectFrame(hit?.robot, hit?.frame ?? "");
  }

  private begin(event: PointerEvent): void {
    const isTouch = event.pointerType === "touch" || event.pointerType === "pen";
    if (!(event.ctrlKey || event.metaKey || isTouch) || this.grasp) return;
    const hit = this.hit(event);
    if (isTouch && !(event.ctrlKey || (hit && hit.frame === this.selection?.frame))) return;
    if (!hit) return;
    if (hit.frame !== this.selection?.frame) this.selectFrame(hit.robot, hit.frame);
    event.stopImmediatePropagation();
    event.preventDefault();
    this.stage.orbit.enabled = false;
    this.stage.canvas.setPointerCapture(event.pointerId);
    const facing = new Vector3();
    this.stage.camera.getWorldDirection(facing);
    this.grasp = {
      pointer: event.pointerId,
      robot: hit.robot,
      frame: hit.frame,
      point: hit.robot.frame(hit.frame).worldToLocal(hit.point.clone()),
      target: hit.point.clone(),
      plane: new Plane().setFromNormalAndCoplanarPoint(facing, hit.point),
    };
    this.send();
    this.timer = setInterval(() => this.send(), REPEAT_MS);
    this.draw();
  }

  private move(event: PointerEvent): void {
    if (event.pointerId !== this.grasp?.pointer) return;
    this.aim(event);
    this.ray.ray.intersectPlane(this.grasp.plane, this.grasp.target);
    this.send();
    this.draw();
  }

  private from(): Vector3 {
    const { robot, frame, point } = this.grasp!;
    const object = robot.frame(frame);
    object.updateWorldMatrix(true, false);
    return object.localToWorld(point.clone());
  }

  private send(): void {
    if (!this.grasp) return;
    const { robot, frame, point, target } = this.grasp;
    const target_m = robot.root.worldToLocal(target.clone()).toArray();
    // Robots that are compared have no name: all of them are pulled.
    this.hold({ robot: robot.look.name, frame, point_m: point.toArray(), target_m });
  }

  private aim(event: MouseEvent): void {
    const box = this.stage.canvas.getBoundingClientRect();
    const at = new Vector2(
      ((event.clientX - box.left) / box.width) * 2 - 1,
      1 - ((event.clientY - box.top) / box.height) * 2,
    );
    this.ray.setFromCamera(at, this.stage.camera);
  }

  private hit(event: MouseEvent): { robot: Robot; frame: string; point: Vector3 } | undefined {
    this.aim(event);
    const hits = this.robots().flatMap(robot =>
      this.ray.intersectObjects(robot.solids(), true).map(hit => ({ robot, hit })),
    );
    hits.sort((a, b) => a.hit.distance - b.hit.distance);
    const first = hits[0];
    return first && { robot: first.robot, frame: first.hit.object.userData["link"] as string, point: first.hit.point };
  }
}
