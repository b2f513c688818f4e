//! Canvas with camera, light, ground, and the loop that draws when something has changed.

import {
  AmbientLight, Box3, BufferAttribute, BufferGeometry, Color, DirectionalLight, Group, HemisphereLight, LineBasicMaterial,
  LineSegments, Object3D, PerspectiveCamera, Scene, ShaderMaterial, Sphere, Vector3, WebGLRenderer,
} from "three";
import { Labels } from "./labels.ts";
import { Orbit } from "./orbit.ts";
import { triad } from "./parts.ts";
import { onTheme } from "./theme.ts";

/** Objects of this layer are parts of robots: the camera is placed by them, and a pointer meets them. */
export const SOLID = 1;
/** Objects of this layer have shadows. */
export const SHADOW = 2;

/** Half of the side of the ground's grid, and the distance of its lines, m. */
const GRID_M = 2;
const GRID_STEP_M = 0.1;

/** Room around the robot in the picture: forces and motions need some. */
const MARGIN = 1.08;

/** A picture that has not changed for this long is drawn finely, ms. */
const STILL_MS = 1000;
const STILL_RATIO = 2;

/** Below this rate of drawing the picture becomes coarser, 1/s. A longer time than the longest between two pictures is a pause of something else. */
const SLOW_HZ = 24;
const LONGEST_MS = 250;

export class Stage {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(32, 1, 0.05, 50);
  readonly labels: Labels;
  readonly orbit: Orbit;
  readonly canvas: HTMLCanvasElement;
  /** Called before each picture with the time since the last one, s. */
  beforeDraw: (dt_s: number) => void = () => {};
  /** Least number of pixels of the canvas for one of the page. */
  coarsest = 0.5;
  /** True while pictures follow each other, so that none of them stays. */
  isMoving = false;
  /** Number of pictures drawn. */
  drawn = 0;
  private readonly renderer: WebGLRenderer;
  private readonly ground = new Group();
  private readonly shadow: ShaderMaterial;
  private requested = false;
  private last_ms = 0;
  private cost_ms = 0;
  private readonly finest = Math.min(2, devicePixelRatio);
  private ratio = this.finest;
  private still = 0;
  private isFine = false;
  private readonly isSmooth: boolean;
  private grid: LineSegments<BufferGeometry, LineBasicMaterial>;

  /** Returns a stage in the element; none if the browser draws no WebGL. */
  static in(container: HTMLElement): Stage | undefined {
    const canvas = document.createElement("canvas");
    // Smooth edges, and what shines through from the page, would cost a browser without a graphics processor most of its pictures.
    const isFast = !drawsInSoftware();
    const context = canvas.getContext("webgl2", { antialias: isFast, alpha: isFast, powerPreference: "high-performance" });
    return context ? new Stage(container, canvas, context) : undefined;
  }

  private constructor(container: HTMLElement, canvas: HTMLCanvasElement, context: WebGL2RenderingContext) {
    this.canvas = canvas;
    this.isSmooth = context.getContextAttributes()?.antialias ?? false;
    this.renderer = new WebGLRenderer({ canvas, context });
    this.renderer.autoClear = false;
    const isOpaque = context.getContextAttributes()?.alpha === false;
    const layer = document.createElement("div");
    layer.className = "labels";
    container.append(canvas, layer);
    this.labels = new Labels(layer);
    this.camera.layers.enable(SOLID);
    this.orbit = new Orbit(this.camera, canvas, () => this.request());

    const sun = new DirectionalLight(0xffffff, 2.1);
    sun.position.set(-0.6, 1.2, 1);
    this.camera.add(sun, sun.target);
    sun.target.position.set(0, 0, -1);
    this.scene.add(this.camera, new HemisphereLight(0xffffff, 0x8d99a6, 1.5), new AmbientLight(0xffffff, 0.35));

    this.shadow = new ShaderMaterial({
      uniforms: { height: { value: 0 }, color: { value: new Color() } },
      vertexShader: `uniform float height; void main() {
        vec4 p = modelMatrix * vec4(position, 1.0);
        p.xy -= vec2(0.25, -0.35) * (p.z - height);
        p.z = height;
        gl_Position = projectionMatrix * viewMatrix * p;
      }`,
      fragmentShader: `uniform vec3 color; void main() {
        gl_FragColor = vec4(color, 1.0);
        #include <colorspace_fragment>
      }`,
    });
    this.grid = new LineSegments(gridGeometry(), new LineBasicMaterial({ transparent: true }));
    this.ground.add(this.grid);
    const axes = triad(0.12, 0.0022);
    this.ground.add(axes);
    for (const [name, at] of [["x", [0.14, 0, 0]], ["y", [0, 0.14, 0]], ["z", [0, 0, 0.14]]] as const) {
      this.labels.add(name, axes, "axis", new Vector3(...at));
    }
    this.scene.add(this.ground);
    onTheme(theme => {
      this.renderer.setClearColor(theme.ground, isOpaque ? 1 : 0);
      this.grid.material.color.set(theme.grid);
      (this.shadow.uniforms["color"]!.value as Color).set(theme.shadow);
      this.request();
    });
    new ResizeObserver(() => this.resize(container)).observe(container);
    this.resize(container);
  }

  /** Height of the ground, m. */
  set groundHeight(height_m: number) {
    this.ground.position.z = height_m;
    this.shadow.uniforms["height"]!.value = height_m;
    this.request();
  }

  /** Draws all pixels from now on, however long it takes. */
  drawFinely(): void {
    this.coarsest = this.ratio = Math.max(STILL_RATIO, this.finest);
    this.resize(this.canvas.parentElement!);
  }

  /** Places the ground below the objects, and the camera so that all of them are seen. */
  show(objects: Object3D[]): void {
    const box = new Box3();
    for (const object of objects) {
      object.updateWorldMatrix(true, true);
      object.traverse(part => {
        if (part.layers.isEnabled(SOLID)) box.expandByObject(part);
      });
    }
    if (box.isEmpty()) return;
    // An arm may hang from its base.
    this.groundHeight = box.min.z > -0.13 ? 0 : Math.floor((box.min.z - 0.02) * 20) / 20;
    const sphere = box.getBoundingSphere(new Sphere());
    this.orbit.frame(sphere.center, Math.max(0.1, MARGIN * sphere.radius));
  }

  /** Asks for a picture. */
  request(): void {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(now => this.draw(now));
  }

  /** Pixel of the page at which a point of the scene (m) is seen. */
  pixel(point: Vector3): { x: number; y: number } {
    const box = this.canvas.getBoundingClientRect();
    const at = point.clone().project(this.camera);
    return { x: box.left + (at.x + 1) * 0.5 * box.width, y: box.top + (1 - at.y) * 0.5 * box.height };
  }

  private resize(container: HTMLElement): void {
    this.setSize(container);
    this.request();
  }

  private setSize(container: HTMLElement): void {
    const [width, height] = [Math.max(1, container.clientWidth), Math.max(1, container.clientHeight)];
    this.renderer.setPixelRatio(this.ratio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  private draw(now_ms: number): void {
    this.requested = false;
    if (this.isFine) {
      this.isFine = false;
      this.setSize(this.canvas.parentElement!);
    }
    const dt_s = Math.min(0.1, Math.max(0, (now_ms - this.last_ms) / 1e3));
    this.coarsen(now_ms - this.last_ms);
    this.last_ms = now_ms;
    this.beforeDraw(dt_s);
    this.scene.updateMatrixWorld();
    this.renderer.clear();
    if (this.camera.position.z > this.ground.position.z) {
      this.camera.layers.set(SHADOW);
      this.scene.overrideMaterial = this.shadow;
      this.renderer.render(this.scene, this.camera);
      this.scene.overrideMaterial = null;
      this.camera.layers.enable(0);
      this.camera.layers.enable(SOLID);
      this.renderer.clearDepth();
    }
    this.renderer.render(this.scene, this.camera);
    this.labels.place(this.camera, this.canvas.clientWidth, this.canvas.clientHeight);
    this.drawn += 1;
    clearTimeout(this.still);
    if (this.isCoarse && !this.isMoving) this.still = setTimeout(() => this.refine(), STILL_MS);
  }

  private get isCoarse(): boolean {
    return !this.isSmooth || this.ratio < this.finest;
  }

  /** Draws a picture that stays with all its pixels; what moves then is coarse again. */
  private refine(): void {
    const coarse = this.ratio;
    this.ratio = Math.max(STILL_RATIO, this.finest);
    this.setSize(this.canvas.parentElement!);
    this.draw(performance.now());
    clearTimeout(this.still);
    this.ratio = coarse;
    this.isFine = true;
  }

  /** Draws fewer pixels where pictures that follow each other take long, as without a graphics processor. */
  private coarsen(interval_ms: number): void {
    if (!this.isMoving) return;
    this.cost_ms += 0.1 * (Math.min(LONGEST_MS, interval_ms) - this.cost_ms);
    if (this.cost_ms > 1e3 / SLOW_HZ && this.ratio > this.coarsest) {
      this.ratio = Math.max(this.coarsest, this.ratio * 0.75);
      this.cost_ms = 0;
      this.resize(this.canvas.parentElement!);
    }
  }
}

/** True if the browser draws without a graphics processor. */
function drawsInSoftware(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  const extension = context?.getExtension("WEBGL_debug_renderer_info");
  const name = extension ? String(context?.getParameter(extension.UNMASKED_RENDERER_WEBGL)) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

function gridGeometry(): BufferGeometry {
  const points: number[] = [];
  const count = Math.round(GRID_M / GRID_STEP_M);
  for (let i = -count; i <= count; i++) {
    const at = i * GRID_STEP_M;
    points.push(at, -GRID_M, 0, at, GRID_M, 0, -GRID_M, at, 0, GRID_M, at, 0);
  }
  return new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(points), 3));
}
