//! Makes the animated picture of the README from the page of a run:
//!
//!     node picture.mjs runs/compliant-x-asimo-arm-position/report.html ../../../docs/compliant-x.gif
//!
//! Needs Chromium. The picture has the colours of the light scheme.

import { writeFileSync } from "node:fs";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";
import { parseArgs } from "node:util";
import gifenc from "gifenc";
import { Browser } from "./browser.mjs";

const { GIFEncoder, applyPalette, quantize } = gifenc;
const { values: options, positionals: [page, out] } = parseArgs({
  allowPositionals: true,
  options: {
    from: { type: "string", default: "0" }, to: { type: "string", default: "8" }, hz: { type: "string", default: "12.5" },
    width: { type: "string", default: "560" }, height: { type: "string", default: "360" }, colors: { type: "string", default: "64" },
  },
});
const [from_s, to_s, hz, width, height] = [options.from, options.to, options.hz, options.width, options.height].map(Number);

const browser = await Browser.start(width + 40, height + 200, 1);
await browser.call("Emulation.setEmulatedMedia", { features: [{ name: "prefers-color-scheme", value: "light" }] });
await browser.open(pathToFileURL(resolve(page)));
await browser.evaluate("new Promise(done => { const look = () => window.opspaceView ? done() : setTimeout(look, 20); look(); })");
// The scene alone, on white and in the size of the picture.
await browser.evaluate(`(() => {
  const stage = document.querySelector('.player .stage');
  stage.style.cssText = 'position: fixed; left: 0; top: 0; z-index: 9; width: ${width}px; height: ${height}px; min-height: 0; border: 0; border-radius: 0; background: #fff';
  scrollTo(0, 0);
  return new Promise(done => setTimeout(done, 300));
})()`);
// From the side, so that x is to the right.
await browser.evaluate("opspaceView.drawFinely(), opspaceView.frame(), opspaceView.orbit(-0.3, -0.1), opspaceView.zoom(0.72)");

// The policy of the page forbids what decodes its picture: another page does it.
const decoder = await Browser.start(100, 100);

/** Pixels of the scene with its labels, at a time of the run. */
async function pixels(time_s) {
  await browser.evaluate(`new Promise(done => { opspaceView.seek(${time_s}); requestAnimationFrame(() => requestAnimationFrame(done)); })`);
  const png = await browser.picture({ x: 0, y: 0, width, height });
  const text = await decoder.evaluate(`(async () => {
    const bitmap = await createImageBitmap(await (await fetch("data:image/png;base64,${png.toString("base64")}")).blob());
    const context = new OffscreenCanvas(${width}, ${height}).getContext("2d");
    context.drawImage(bitmap, 0, 0);
    let text = "";
    const { data } = context.getImageData(0, 0, ${width}, ${height});
    for (let i = 0; i < data.length; i += 8192) text += String.fromCharCode(...data.subarray(i, i + 8192));
    return btoa(text);
  })()`);
  return new Uint8Array(Buffer.from(text, "base64"));
}

const count = Math.round((to_s - from_s) * hz);
const pictures = [];
for (let k = 0; k < count; k++) pictures.push(await pixels(from_s + k / hz));
browser.close();
decoder.close();

// One palette of all pictures: what stands still keeps its colour, and takes no space.
const some = pictures.filter((_, k) => k % 8 === 0);
const sample = new Uint8Array(some.length * some[0].length);
some.forEach((picture, k) => sample.set(picture, k * picture.length));
const palette = quantize(sample, Number(options.colors) - 1);
const transparent = palette.push([0, 0, 0]) - 1;
const gif = GIFEncoder();
let last;
for (const [k, picture] of pictures.entries()) {
  const index = applyPalette(picture, palette.slice(0, -1));
  const shown = index.map((color, i) => (last && last[i] === color ? transparent : color));
  gif.writeFrame(shown, width, height, {
    palette: k === 0 ? palette : undefined, delay: 1000 / hz, transparent: k > 0, transparentIndex: transparent, dispose: 1, repeat: 0,
  });
  last = index;
}
gif.finish();
writeFileSync(out, gif.bytes());
console.log(`${out}: ${count} pictures, ${gif.bytes().length} bytes`);
