//! Leaves out parts of three.js that the scene does not use. A bundler cannot: the renderer refers to all of them.
//! The scene has lambert, basic and line materials and a shader of its own; no textures of light, shadows, skins or headsets.

import { readFileSync } from "node:fs";

/** Programs of materials that the scene does not have, and parts of programs behind conditions that it never sets. */
const SHADERS = [
  // Kept: basic (a), lambert (9) and lines (b).
  /^(vertex|fragment)($|\$[^9ab]$)/,
  /^(shadow|skin|morph|lights_(physical|phong|toon)|lightprobes|envmap|clearcoat|iridescence|transmission|clipping|displacementmap)/,
  /^(bumpmap|batching|logdepthbuf|gradientmap|metalnessmap|roughnessmap|tonemapping|dithering|lightmap|aomap|emissivemap)/,
  /^(normalmap|alphamap|alphahash|map_particle|specularmap_pars|fog)/,
];

/** Classes that need no more than to exist. */
const CLASSES = {
  WebXRManager: `class WebXRManager extends EventDispatcher {
    enabled = false; isPresenting = false; cameraAutoUpdate = false;
    setAnimationLoop() {} dispose() {} getDepthSensingMesh() { return null; } hasDepthSensing() { return false; }
    getEnvironmentBlendMode() {}
  }`,
  PMREMGenerator: "class PMREMGenerator { dispose() {} }",
};

export const slim = {
  name: "slim",
  setup(build) {
    build.onLoad({ filter: /three\.module\.js$/ }, ({ path }) => {
      let text = readFileSync(path, "utf8");
      let shaders = 0;
      text = text.replace(/^(?:const|var) (\w+\$?\w*) = ("(?:[^"\\]|\\.)*");$/gm, (line, name, value) => {
        if (!SHADERS.some(pattern => pattern.test(name))) return line;
        shaders += 1;
        return line.replace(value, '""');
      });
      if (shaders < 40) throw new Error(`only ${shaders} shaders were found in three.js`);
      for (const [name, stub] of Object.entries(CLASSES)) {
        const begin = text.search(new RegExp(`^class ${name} `, "m"));
        const end = text.indexOf("\n}\n", begin);
        if (begin < 0 || end < 0) throw new Error(`three.js has no class ${name}`);
        text = text.slice(0, begin) + stub + text.slice(end + 2);
      }
      return { contents: text, loader: "js" };
    });
    // What is unusual in a mesh is no message for the user of a robot.
    build.onLoad({ filter: /jsm.loaders.*\.js$/ }, ({ path }) => {
      const text = readFileSync(path, "utf8");
      return { contents: `const console = { log() {}, debug() {}, warn() {}, error() {} };\n${text}`, loader: "js" };
    });
  },
};
