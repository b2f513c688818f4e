//! Shapes of which the scene is made. Lengths in m.

import {
  BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, Color, ConeGeometry, CylinderGeometry, DoubleSide,
  EdgesGeometry, Group, InstancedMesh, LineBasicMaterial, LineSegments, Material, Matrix4, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, Object3D, Quaternion, SphereGeometry, Vector3,
} from "three";

const X = new Vector3(1, 0, 0);
const Y = new Vector3(0, 1, 0);
const UNIT_CYLINDER = new CylinderGeometry(1, 1, 1, 10, 1);
/** Piece of a line: with few corners, as a path has many pieces, and no light shows them. */
const UNIT_PIECE = new CylinderGeometry(1, 1, 1, 5, 1, true);
/** A point that is farther away from the last one does not continue the line, m. */
const JUMP_M = 0.2;
const UNIT_CONE = new ConeGeometry(1, 1, 18);

/** Capsule between two points. */
export function capsule(start: Vector3, end: Vector3, radius: number, material: Material): Mesh {
  const axis = end.clone().sub(start);
  const length = axis.length();
  const geometry =
    length > 0 ? new CapsuleGeometry(radius, length, 6, 18) : new SphereGeometry(radius, 18, 12);
  const mesh = new Mesh(geometry, material);
  mesh.position.copy(start).add(end).multiplyScalar(0.5);
  if (length > 0) mesh.quaternion.setFromUnitVectors(Y, axis.divideScalar(length));
  return mesh;
}

export function box(x: number, y: number, z: number, material: Material): Mesh {
  return new Mesh(new BoxGeometry(x, y, z), material);
}

export function sphere(radius: number, material: Material): Mesh {
  return new Mesh(new SphereGeometry(radius, 32, 20), material);
}

/** Cylinder along z, as in URDF. */
export function cylinder(radius: number, length: number, material: Material): Mesh {
  const geometry = new CylinderGeometry(radius, radius, length, 36);
  geometry.rotateX(Math.PI / 2);
  return new Mesh(geometry, material);
}

/** Slab with visible edges: a wall that does not hide what is behind it. */
export function slab(size: Vector3, color: number): Group {
  const geometry = new BoxGeometry(size.x, size.y, size.z);
  const faces = new MeshBasicMaterial({ color, transparent: true, opacity: 0.22, side: DoubleSide, depthWrite: false });
  const edges = new LineSegments(new EdgesGeometry(geometry), new LineBasicMaterial({ color }));
  return new Group().add(new Mesh(geometry, faces), edges);
}

/** Axes of a frame: x red, y green, z blue. */
export function triad(length: number, radius: number, opacity = 1): Mesh {
  const parts = ([[X, 0xd8443c], [Y, 0x3f9f3f], [new Vector3(0, 0, 1), 0x3b6fd6]] as const).map(([axis, color]) => {
    const part = new CylinderGeometry(radius, radius, length, 8);
    part.translate(0, length / 2, 0);
    part.applyQuaternion(new Quaternion().setFromUnitVectors(Y, axis));
    return { part, color: new Color(color) };
  });
  const [positions, colors]: [number[], number[]] = [[], []];
  for (const { part, color } of parts) {
    const flat = part.toNonIndexed().getAttribute("position");
    positions.push(...flat.array);
    for (let i = 0; i < flat.count; i++) colors.push(color.r, color.g, color.b);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(positions), 3));
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(colors), 3));
  return new Mesh(geometry, new MeshBasicMaterial({ vertexColors: true, transparent: opacity < 1, opacity }));
}

/** Draws an object over all others: what is inside a link is seen, too. */
export function onTop<T extends Object3D>(object: T, order: number): T {
  object.traverse(part => {
    part.renderOrder = order;
    if (!(part instanceof Mesh)) return;
    // Opaque objects are drawn before transparent ones, whatever their order.
    Object.assign(part.material as Material, { depthTest: false, transparent: true });
  });
  return object;
}

/** Arrow from a point along a vector. */
export class Arrow extends Group {
  private readonly shaft: Mesh;
  private readonly head: Mesh;

  constructor(color: number, private readonly radius: number) {
    super();
    const material = new MeshLambertMaterial({ color });
    this.shaft = new Mesh(UNIT_CYLINDER, material);
    this.head = new Mesh(UNIT_CONE, material);
    this.add(this.shaft, this.head);
    this.visible = false;
  }

  set(from: Vector3, vector: Vector3): void {
    const length = vector.length();
    this.visible = length > 1e-4;
    if (!this.visible) return;
    this.position.copy(from);
    this.quaternion.setFromUnitVectors(Y, vector.clone().divideScalar(length));
    const head = Math.min(0.4 * length, 6 * this.radius);
    this.shaft.scale.set(this.radius, length - head, this.radius);
    this.shaft.position.y = (length - head) / 2;
    this.head.scale.set(2.4 * this.radius, head, 2.4 * this.radius);
    this.head.position.y = length - head / 2;
  }
}

/** Line of a given thickness through points; the oldest points are dropped. */
export class Trail extends InstancedMesh<BufferGeometry, MeshBasicMaterial> {
  private readonly lastPoint = new Vector3();
  private isEmpty = true;
  private next = 0;

  constructor(color: number, private readonly radius: number, private readonly most: number, opacity = 1) {
    super(UNIT_PIECE, new MeshBasicMaterial({ color, transparent: opacity < 1, opacity }), most);
    this.count = 0;
    // Its bounds change with every point.
    this.frustumCulled = false;
  }

  clear(): this {
    this.count = this.next = 0;
    this.isEmpty = true;
    return this;
  }

  /** Appends a point, unless it is closer than the diameter to the last one. */
  add_point(point: Vector3): void {
    if (this.isEmpty) {
      this.lastPoint.copy(point);
      this.isEmpty = false;
      return;
    }
    const distance = point.distanceTo(this.lastPoint);
    if (distance < 2 * this.radius) return;
    if (distance > JUMP_M) {
      this.lastPoint.copy(point);
      return;
    }
    this.setMatrixAt(this.next, segment(this.lastPoint, point, this.radius));
    this.instanceMatrix.needsUpdate = true;
    this.lastPoint.copy(point);
    this.next = (this.next + 1) % this.most;
    this.count = Math.min(this.most, this.count + 1);
  }
}

/** Placement of a unit cylinder between two points. */
export function segment(start: Vector3, end: Vector3, radius: number): Matrix4 {
  const axis = end.clone().sub(start);
  const length = axis.length();
  const rotation = new Quaternion().setFromUnitVectors(Y, length > 0 ? axis.divideScalar(length) : Y);
  return new Matrix4().compose(start.clone().add(end).multiplyScalar(0.5), rotation, new Vector3(radius, length, radius));
}

/** Straight line between two points that can be moved. */
export class Rod extends Mesh<BufferGeometry, MeshBasicMaterial> {
  constructor(color: number, private readonly radius: number) {
    super(UNIT_CYLINDER, new MeshBasicMaterial({ color }));
    this.matrixAutoUpdate = false;
    this.visible = false;
  }

  set(start: Vector3, end: Vector3): void {
    this.visible = true;
    this.matrix.copy(segment(start, end, this.radius));
  }
}
