//! Walls, obstacles and other objects that are fixed in the world.

import { Group, Material, MeshLambertMaterial, Object3D, Quaternion, Vector3 } from "three";
import type { Label } from "./labels.ts";
import { capsule, slab, sphere } from "./parts.ts";
import type { Stage } from "./stage.ts";
import { onTheme, theme } from "./theme.ts";

const X = new Vector3(1, 0, 0);

export class Environment {
  private readonly objects = new Map<string, { object: Object3D; label: Label }>();
  readonly obstacle = new MeshLambertMaterial({ transparent: true, opacity: 0.6 });

  constructor(private readonly stage: Stage) {
    onTheme(colors => this.obstacle.color.set(colors.obstacle));
  }

  /** Wall of that size with its centre and outward normal. */
  addWall(name: string, center: Vector3, normal: Vector3, size: Vector3): void {
    const wall = slab(size, theme().wall);
    wall.position.copy(center);
    wall.quaternion.setFromUnitVectors(X, normal);
    this.add(name, wall, new Vector3(0, 0, size.z / 2));
  }

  addCapsule(name: string, start: Vector3, end: Vector3, radius: number): void {
    this.add(name, new Group().add(capsule(start, end, radius, this.obstacle)), end);
  }

  addBall(name: string, center: Vector3, radius: number, material: Material = this.obstacle): void {
    const ball = sphere(radius, material);
    ball.position.copy(center);
    this.add(name, ball, new Vector3(0, 0, radius));
  }

  /** Moves an object. */
  move(name: string, position: Vector3, rotation?: Quaternion): void {
    const object = this.objects.get(name)?.object;
    object?.position.copy(position);
    if (rotation) object?.quaternion.copy(rotation);
  }

  add(name: string, object: Object3D, labelAt: Vector3): void {
    const former = this.objects.get(name);
    if (former) {
      former.object.removeFromParent();
      this.stage.labels.remove(former.label);
    }
    this.stage.scene.add(object);
    this.objects.set(name, { object, label: this.stage.labels.add(name, object, "environment", labelAt) });
    this.stage.request();
  }
}
