//! Visual shapes of the links of a URDF.

import { Color, Euler, Group, MeshLambertMaterial, Object3D } from "three";
import { box, cylinder, sphere } from "./parts.ts";

/** Reader of a mesh from its address; a colour replaces those of the mesh. */
type LoadMesh = (url: string, color: Color | undefined) => Promise<Object3D>;

/** Calls `found` with the shapes of each link that has some; again when a mesh has been read. Without a reader of meshes, a link with a mesh
 * has no shape. */
export function visuals(urdf: string, found: (link: string, shape: Object3D) => void, loadMesh?: LoadMesh): void {
  const document = new DOMParser().parseFromString(urdf, "application/xml");
  const colors = new Map<string, Color>();
  for (const material of children(document.documentElement, "material")) {
    const color = colorOf(material, colors);
    if (color) colors.set(material.getAttribute("name") ?? "", color);
  }
  for (const link of children(document.documentElement, "link")) {
    const name = link.getAttribute("name") ?? "";
    if (!loadMesh && link.querySelector("visual mesh")) continue;
    const shape = new Group();
    shape.userData["isMesh"] = link.querySelector("visual mesh") !== null;
    for (const visual of children(link, "visual")) {
      const place = new Group();
      const origin = children(visual, "origin")[0];
      place.position.fromArray(numbers(origin, "xyz", [0, 0, 0]));
      const [roll, pitch, yaw] = numbers(origin, "rpy", [0, 0, 0]);
      // Fixed axes x, y, z are moving axes z, y, x.
      place.setRotationFromEuler(new Euler(roll, pitch, yaw, "ZYX"));
      const material = children(visual, "material")[0];
      const color = material && colorOf(material, colors);
      const geometry = children(visual, "geometry")[0]?.firstElementChild;
      if (geometry) addGeometry(geometry, place, color, loadMesh, () => found(name, shape));
      shape.add(place);
    }
    if (holdsMesh(shape)) found(name, shape);
  }
}

function addGeometry(
  geometry: Element,
  place: Group,
  color: Color | undefined,
  loadMesh: LoadMesh | undefined,
  changed: () => void,
): void {
  const number = (name: string) => Number(geometry.getAttribute(name) ?? 0);
  const material = new MeshLambertMaterial({ color: color ?? 0xffffff });
  const add = (shape: Object3D) => {
    shape.userData["plain"] = color === undefined;
    place.add(shape);
  };
  if (geometry.tagName === "box") {
    const [x = 0, y = 0, z = 0] = numbers(geometry, "size", [0, 0, 0]);
    add(box(x, y, z, material));
  } else if (geometry.tagName === "cylinder") {
    add(cylinder(number("radius"), number("length"), material));
  } else if (geometry.tagName === "sphere") {
    add(sphere(number("radius"), material));
  } else if (geometry.tagName === "mesh") {
    const url = geometry.getAttribute("filename") ?? "";
    // Only what the program serves: nothing comes from another place.
    if (!loadMesh || !url.startsWith("/mesh/")) return;
    loadMesh(url, color).then(
      mesh => {
        mesh.scale.fromArray(numbers(geometry, "scale", [1, 1, 1])).multiply(mesh.userData["unit"] ?? { x: 1, y: 1, z: 1 });
        place.add(mesh);
        changed();
      },
      // The link keeps its capsules.
      () => {},
    );
  }
}

/** True once the shape has something to be seen. */
function holdsMesh(shape: Object3D): boolean {
  let holds = false;
  shape.traverse(part => (holds ||= "isMesh" in part));
  return holds;
}

function colorOf(material: Element, known: Map<string, Color>): Color | undefined {
  const rgba = children(material, "color")[0]?.getAttribute("rgba");
  if (!rgba) return known.get(material.getAttribute("name") ?? "");
  const [r = 1, g = 1, b = 1] = rgba.trim().split(/\s+/).map(Number);
  return new Color().setRGB(r, g, b, "srgb");
}

function children(element: Element, tag: string): Element[] {
  return [...element.children].filter(child => child.tagName === tag);
}

function numbers(element: Element | undefined, name: string, otherwise: number[]): [number, number, number] {
  const values = element?.getAttribute(name)?.trim().split(/\s+/).map(Number) ?? otherwise;
  return values.length === 3 && values.every(Number.isFinite) ? (values as [number, number, number]) : (otherwise as [number, number, number]);
}
