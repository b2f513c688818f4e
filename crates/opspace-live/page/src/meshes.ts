//! Meshes of links: STL, OBJ and DAE (Collada).

import { BufferGeometry, Color, Group, Mesh, MeshLambertMaterial, Object3D, Vector3 } from "three";
import { ColladaLoader } from "three/examples/jsm/loaders/ColladaLoader.js";
import { OBJLoader } from "three/examples/jsm/loaders/OBJLoader.js";
import { STLLoader } from "three/examples/jsm/loaders/STLLoader.js";

/** Reads a mesh; `color` replaces colours of its own. */
export async function loadMesh(url: string, color: Color | undefined): Promise<Object3D> {
  const response = await fetch(url + location.search);
  if (!response.ok) throw new Error(`${url}: ${response.status}`);
  const bytes = await response.arrayBuffer();
  const shape = parse(bytes);
  shape.traverse(part => {
    if (!(part instanceof Mesh)) return;
    const own = ([] as unknown[]).concat(part.material)[0] as { color?: Color };
    part.userData["plain"] = color === undefined && shape.userData["isPlain"] === true;
    part.material = new MeshLambertMaterial({ color: color ?? own.color ?? 0xffffff });
    // Several materials of a part are one.
    (part.geometry as BufferGeometry).clearGroups();
  });
  return shape;
}

/** The address does not tell the format: the content does. */
function parse(bytes: ArrayBuffer): Object3D {
  const begin = new TextDecoder().decode(bytes.slice(0, 4096));
  if (begin.includes("<COLLADA")) {
    // Without textures, which would be files of their own.
    const text = new TextDecoder().decode(bytes).replace(/<library_images>[^]*?<\/library_images>/, "");
    const collada = new ColladaLoader().parse(text, "");
    if (!collada) throw new Error("not a Collada file");
    const scene = collada.scene as unknown as Group;
    const whole = new Group().add(scene);
    // The loader turns the scene so that y is up; URDF has the axes of the file.
    scene.rotation.set(0, 0, 0);
    const unit = scene.scale.x;
    scene.scale.set(1, 1, 1);
    whole.userData["unit"] = new Vector3(unit, unit, unit);
    scene.traverse(part => {
      if ("isLight" in part || "isCamera" in part) part.visible = false;
    });
    return whole;
  }
  if (isObj(begin) && !isBinaryStl(bytes)) {
    const shape = new OBJLoader().parse(new TextDecoder().decode(bytes));
    shape.userData["isPlain"] = true;
    return shape;
  }
  const geometry = new STLLoader().parse(bytes);
  // Those of a file may be zero.
  geometry.computeVertexNormals();
  const shape = new Group().add(new Mesh(geometry));
  shape.userData["isPlain"] = true;
  return shape;
}

function isObj(begin: string): boolean {
  return /^(v|vn|vt|f|o|g|mtllib|usemtl|s)\s/m.test(begin) && !/^\s*solid\b[^]*facet/.test(begin);
}

/** A binary STL has 84 bytes, and 50 for each triangle. */
function isBinaryStl(bytes: ArrayBuffer): boolean {
  return bytes.byteLength >= 84 && new DataView(bytes).getUint32(80, true) * 50 + 84 === bytes.byteLength;
}
