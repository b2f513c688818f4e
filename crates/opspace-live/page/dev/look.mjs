//! Takes a picture of a page: node dev/look.mjs URL OUT.png [--width 1280] [--height 800] [--dark] [--touch] [--after S] [--do EXPRESSION]
//! [--full] [--rate S]. Messages on the console are printed.

import { writeFileSync } from "node:fs";
import { parseArgs } from "node:util";
import { Browser } from "../browser.mjs";

const { values, positionals: [url, out] } = parseArgs({
  allowPositionals: true,
  options: {
    width: { type: "string", default: "1280" }, height: { type: "string", default: "800" }, dark: { type: "boolean" }, touch: { type: "boolean" },
    after: { type: "string", default: "3" }, do: { type: "string" }, full: { type: "boolean" }, drag: { type: "string" },
  },
});
const [width, height] = [Number(values.width), Number(values.height)];
setTimeout(() => process.exit(1), 60e3).unref();
const browser = await Browser.start(width, height);
const scheme = [{ name: "prefers-color-scheme", value: values.dark ? "dark" : "light" }];
await browser.call("Emulation.setEmulatedMedia", { features: scheme });
if (values.touch) {
  await browser.call("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: 2, mobile: true });
  await browser.call("Emulation.setTouchEmulationEnabled", { enabled: true });
}
const wait = s => new Promise(done => setTimeout(done, 1e3 * s));
await browser.open(url);
await wait(Number(values.after));
if (values.do) console.log(JSON.stringify(await browser.evaluate(values.do)));
if (values.drag) {
  // FRAME,DX,DY: pulls with Ctrl, and looks while it is held.
  const [frame, dx, dy] = values.drag.split(",");
  const prefix = await browser.evaluate("opspaceView.state().robots[0].prefix");
  const { x, y } = await browser.evaluate(`opspaceView.pixel("${frame}", "${prefix}")`);
  const mouse = (type, x, y) => browser.call("Input.dispatchMouseEvent", { type, x, y, button: "left", buttons: 1, clickCount: 1, modifiers: 2 });
  await mouse("mousePressed", x, y);
  for (let i = 1; i <= 10; i++) {
    await mouse("mouseMoved", x + (dx * i) / 10, y + (dy * i) / 10);
    await wait(0.05);
  }
  await wait(0.3);
  console.log("holding", await browser.evaluate("opspaceView.isHolding() + ' ' + JSON.stringify(opspaceView.state().robots[0].hand)"));
  writeFileSync(out, await browser.picture());
  await mouse("mouseReleased", x + Number(dx), y + Number(dy));
  await wait(0.3);
  console.log("released", await browser.evaluate("opspaceView.isHolding() + ' ' + JSON.stringify(opspaceView.state().robots[0].hand)"));
} else {
  const clip = values.full ? { x: 0, y: 0, width, height: await browser.evaluate("document.documentElement.scrollHeight") } : undefined;
  writeFileSync(out, await browser.picture(clip));
}
console.log("pictures/s", await browser.evaluate("window.opspaceView?.picturesPerSecond?.() ?? null"));
for (const complaint of new Set(browser.complaints)) console.log("console:", complaint.slice(0, 600));
browser.close();
