//! Headless Chromium by the DevTools protocol: enough to open a page, evaluate, move a pointer and take pictures.

import { spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

const NAMES = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];

export class Browser {
  #process;
  #profile = mkdtempSync(join(tmpdir(), "opspace-browser-"));
  #waiting = new Map();
  #lastId = 0;
  #rest = "";
  #loaded = () => {};
  /** Messages on the console. */
  complaints = [];

  /** Starts the first browser that is installed. */
  static async start(width, height, scale = 1) {
    for (const name of NAMES) {
      const browser = new Browser();
      if (await browser.#open(name, width, height, scale)) return browser;
      rmSync(browser.#profile, { recursive: true, force: true });
    }
    throw new Error(`none of ${NAMES.join(", ")} is installed`);
  }

  async #open(name, width, height, scale) {
    this.#process = spawn(name, [
      "--headless", "--remote-debugging-pipe", "--no-sandbox", "--no-first-run", "--disable-background-networking",
      "--use-angle=swiftshader", "--enable-unsafe-swiftshader", `--user-data-dir=${this.#profile}`, `--window-size=${width},${height}`, "about:blank",
    ], { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
    const isRunning = await new Promise(done => {
      this.#process.once("spawn", () => done(true));
      this.#process.once("error", () => done(false));
    });
    if (!isRunning) return false;
    process.once("exit", () => this.#process.kill("SIGKILL"));
    this.#process.stdio[4].on("data", data => {
      const parts = (this.#rest + data).split("\0");
      this.#rest = parts.pop();
      parts.map(part => JSON.parse(part)).forEach(message => this.#receive(message));
    });
    const { targetId } = await this.call("Target.createTarget", { url: "about:blank" });
    const { sessionId } = await this.call("Target.attachToTarget", { targetId, flatten: true });
    this.session = sessionId;
    for (const domain of ["Page", "Runtime", "Log"]) await this.call(`${domain}.enable`);
    await this.call("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: scale, mobile: false });
    return true;
  }

  #receive(message) {
    if (message.id) {
      const { done, failed } = this.#waiting.get(message.id);
      this.#waiting.delete(message.id);
      if (message.error) failed(new Error(message.error.message));
      else done(message.result);
    } else if (message.method === "Page.loadEventFired") {
      this.#loaded();
    } else if (message.method === "Runtime.consoleAPICalled") {
      this.complaints.push(message.params.args.map(value => value.value ?? value.description).join(" "));
    } else if (message.method === "Runtime.exceptionThrown") {
      this.complaints.push(message.params.exceptionDetails.exception?.description ?? message.params.exceptionDetails.text);
    } else if (message.method === "Log.entryAdded") {
      this.complaints.push(`${message.params.entry.text} ${message.params.entry.url ?? ""}`);
    }
  }

  call(method, params = {}) {
    const id = ++this.#lastId;
    this.#process.stdio[3].write(`${JSON.stringify({ id, method, params, sessionId: this.session })}\0`);
    return new Promise((done, failed) => this.#waiting.set(id, { done, failed }));
  }

  async open(url) {
    const loaded = new Promise(done => (this.#loaded = done));
    const { errorText } = await this.call("Page.navigate", { url });
    if (errorText) throw new Error(`${url}: ${errorText}`);
    await loaded;
  }

  async evaluate(expression) {
    const { result, exceptionDetails } = await this.call("Runtime.evaluate", { expression, awaitPromise: true, returnByValue: true });
    if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? exceptionDetails.text);
    return result.value;
  }

  /** Picture of the page, or of a part of it, as PNG. */
  async picture(clip) {
    const { data } = await this.call("Page.captureScreenshot", { format: "png", ...(clip && { clip: { scale: 1, ...clip } }) });
    return Buffer.from(data, "base64");
  }

  close() {
    this.#process.kill("SIGKILL");
    this.#process.once("exit", () => {
      try {
        rmSync(this.#profile, { recursive: true, force: true, maxRetries: 5 });
      } catch {
        // Processes of the browser that still end write into it: it stays in the folder for temporary files.
      }
    });
  }
}
