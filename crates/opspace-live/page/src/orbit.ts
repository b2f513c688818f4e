//! Orbit camera with z up: drag to orbit, with Shift or the right button or two fingers to move, wheel or pinch to zoom.

import { PerspectiveCamera, Vector3 } from "three";

/** Inclination is kept this far from the poles, rad: the camera has no roll. */
const POLE_RAD = 0.02;
const RAD_PER_PIXEL = 0.006;

export class Orbit {
  readonly target = new Vector3();
  /** Direction of the camera from the target: angle from x about z, and elevation. */
  azimuth_rad = -1.05;
  elevation_rad = 0.36;
  distance_m = 2;
  enabled = true;
  private readonly pointers = new Map<number, { x: number; y: number }>();

  constructor(
    private readonly camera: PerspectiveCamera,
    private readonly element: HTMLElement,
    private readonly changed: () => void,
  ) {
    element.addEventListener("pointerdown", event => this.down(event));
    element.addEventListener("pointermove", event => this.move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      element.addEventListener(kind, event => this.pointers.delete(event.pointerId));
    }
    element.addEventListener("contextmenu", event => event.preventDefault());
    element.addEventListener(
      "wheel",
      event => {
        // A page that contains the scene keeps its wheel.
        if (element.dataset["wheel"] === "page" && !event.ctrlKey) return;
        event.preventDefault();
        this.zoom(Math.exp(event.deltaY * 0.001));
      },
      { passive: false },
    );
    this.apply();
  }

  /** Shows a sphere around a point. */
  frame(center: Vector3, radius_m: number): void {
    this.target.copy(center);
    // The narrower of the two opening angles decides.
    const half = (this.camera.fov * Math.PI) / 360;
    const narrow = Math.min(half, Math.atan(Math.tan(half) * this.camera.aspect));
    this.distance_m = radius_m / Math.sin(narrow);
    this.apply();
  }

  /** Looks from a direction: angle from x about z, and elevation. */
  lookFrom(azimuth_rad: number, elevation_rad: number): void {
    [this.azimuth_rad, this.elevation_rad] = [azimuth_rad, 0];
    this.turn(0, elevation_rad);
  }

  turn(azimuth_rad: number, elevation_rad: number): void {
    const most = Math.PI / 2 - POLE_RAD;
    this.azimuth_rad += azimuth_rad;
    this.elevation_rad = Math.min(most, Math.max(-most, this.elevation_rad + elevation_rad));
    this.apply();
  }

  zoom(factor: number): void {
    this.distance_m = Math.min(100, Math.max(0.05, this.distance_m * factor));
    this.apply();
  }

  apply(): void {
    const [a, e] = [this.azimuth_rad, this.elevation_rad];
    this.camera.up.set(0, 0, 1);
    this.camera.position
      .set(Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e))
      .multiplyScalar(this.distance_m)
      .add(this.target);
    this.camera.lookAt(this.target);
    this.camera.near = this.distance_m / 50;
    this.camera.far = this.distance_m * 50;
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    this.changed();
  }

  private down(event: PointerEvent): void {
    if (!this.enabled) return;
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.element.setPointerCapture(event.pointerId);
  }

  private move(event: PointerEvent): void {
    const last = this.pointers.get(event.pointerId);
    if (!last || !this.enabled) return;
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    const other = others[0];
    if (other) {
      const before = Math.hypot(last.x - other.x, last.y - other.y);
      const after = Math.hypot(event.clientX - other.x, event.clientY - other.y);
      if (before > 0 && after > 0) this.distance_m *= before / after;
      // Both fingers report: each moves the target by half.
      this.pan(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 6) {
      this.pan(dx, dy);
    } else {
      this.turn(-dx * RAD_PER_PIXEL, dy * RAD_PER_PIXEL);
    }
    last.x = event.clientX;
    last.y = event.clientY;
  }

  private pan(dx: number, dy: number): void {
    const height_m = 2 * this.distance_m * Math.tan((this.camera.fov * Math.PI) / 360);
    const m_per_pixel = height_m / Math.max(1, this.element.clientHeight);
    const [right, up] = [new Vector3(), new Vector3()];
    this.camera.matrixWorld.extractBasis(right, up, new Vector3());
    this.target.addScaledVector(right, -dx * m_per_pixel).addScaledVector(up, dy * m_per_pixel);
    this.apply();
  }
}
