//! Walls and obstacles, which are fixed in the world, and objects that robots hold.

import { Group, MeshLambertMaterial, Object3D, Vector3 } from "three";
import type { Label } from "./labels.ts";
import { box, capsule, slab, sphere } from "./parts.ts";
import type { Pose } from "./robot.ts";
import { SHADOW, type Stage } from "./stage.ts";
import { onTheme, theme } from "./theme.ts";

const X = new Vector3(1, 0, 0);

export class Environment {
  private readonly objects = new Map<string, { object: Object3D; label: Label }>();
  readonly obstacle = new MeshLambertMaterial({ transparent: true, opacity: 0.6 });

  private readonly held = new MeshLambertMaterial();

  constructor(private readonly stage: Stage) {
    onTheme(colors => {
      this.obstacle.color.set(colors.obstacle);
      this.held.color.set(colors.obstacle);
    });
  }

  /** Wall of that size with its centre and outward normal, in the world of a robot. */
  addWall(world: Object3D, name: string, center: Vector3, normal: Vector3, size: Vector3): void {
    const wall = slab(size, theme().wall);
    wall.position.copy(center);
    wall.quaternion.setFromUnitVectors(X, normal);
    wall.userData["isWall"] = true;
    this.add(world, name, wall, new Vector3(0, 0, size.z / 2));
  }

  addCapsule(world: Object3D, name: string, start: Vector3, end: Vector3, radius: number): void {
    this.add(world, name, new Group().add(capsule(start, end, radius, this.obstacle)), end);
  }

  /** Shows a moving object at a pose, as a box of a size or a ball of a diameter (m); hides it without a pose. It stays in the world in
   * which it is first shown. */
  showObject(world: Object3D, name: string, pose: Pose | undefined, box_m: Vector3 | undefined, diameter_m = 0): void {
    let object = this.objects.get(name)?.object;
    if (!object && pose) {
      object = box_m ? box(box_m.x, box_m.y, box_m.z, this.held) : sphere(diameter_m / 2, this.held);
      object.layers.enable(SHADOW);
      this.add(world, name, object, new Vector3(0, 0, (box_m?.z ?? diameter_m) / 2));
    }
    if (!object) return;
    object.visible = pose !== undefined;
    if (!pose) return;
    object.position.copy(pose.position);
    object.quaternion.copy(pose.rotation);
  }

  private add(world: Object3D, name: string, object: Object3D, labelAt: Vector3): void {
    const former = this.objects.get(name);
    if (former) {
      former.object.removeFromParent();
      this.stage.labels.remove(former.label);
    }
    world.add(object);
    this.objects.set(name, { object, label: this.stage.labels.add(name, object, "environment", labelAt) });
    this.stage.request();
  }
}
