//! Stands in for the program while the page is developed: replays a log, and moves no robot.
//!
//!     node dev/server.mjs run.mcap [PORT] [--robots N] [--run] [--urdf FILE]
//!
//! `--robots N` shows the log N times, with delays. `--run` claims to be a simulation, so that the hand can be tried. `--urdf` replaces the
//! robot's description; the meshes that it names are served.

import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { dirname, resolve } from "node:path";
import { parseArgs } from "node:util";
import { McapIndexedReader } from "@mcap/core";
import { decompress } from "fzstd";
import { WebSocketServer } from "ws";

const { values: options, positionals } = parseArgs({
  allowPositionals: true,
  options: { robots: { type: "string", default: "1" }, run: { type: "boolean" }, urdf: { type: "string" } },
});
const [path, port = "8700"] = positionals;
const bytes = readFileSync(path);
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, size) => new Uint8Array(bytes.subarray(Number(offset), Number(offset + size))),
};
const decompressHandlers = { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) };
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
const messages = [];
const topics = new Map();
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  if (channel.topic.startsWith("/opspace/") && channel.topic !== "/opspace/tick") continue;
  const schema = reader.schemasById.get(channel.schemaId);
  topics.set(channel.topic, { schema: schema.name, encoding: channel.messageEncoding, definition: schema });
  messages.push({ topic: channel.topic, ns: message.logTime, data: Buffer.from(message.data) });
}
const begin_ns = messages.find(message => message.topic === "/tf").ns;
const duration_s = Number(messages.at(-1).ns - begin_ns) * 1e-9;
const once = messages.filter((m, i, all) => all.findIndex(n => n.topic === m.topic) === i && all.filter(n => n.topic === m.topic).length === 1);
const moving = messages.filter(message => !once.includes(message) && !message.topic.startsWith("/opspace/"));

const meshes = [];
if (options.urdf) {
  const text = readFileSync(options.urdf, "utf8").replace(/filename="([^"]+)"/g, (_, name) => {
    meshes.push(resolve(dirname(options.urdf), name.replace(/^package:\/\//, "")));
    return `filename="/mesh/${meshes.length - 1}"`;
  });
  const body = Buffer.from(`${text}\0`);
  const head = Buffer.alloc(8);
  head[1] = 1;
  head.writeUInt32LE(body.length, 4);
  const description = once.find(message => message.topic === "/robot_description");
  description.data = Buffer.concat([head, body]);
}

const count = Number(options.robots);
const prefixes = count === 1 ? [""] : ["/position", "/torque", "/ik", "/fourth"].slice(0, count);
const channels = [{ id: 0, topic: "/view", encoding: "json", schemaName: "View" }];
const idOf = new Map();
for (const prefix of prefixes) {
  for (const [topic, { schema, encoding }] of topics) {
    if (topic.startsWith("/opspace/")) continue;
    idOf.set(prefix + topic, channels.length);
    channels.push({ id: channels.length, topic: prefix + topic, encoding, schemaName: schema });
  }
  idOf.set(`${prefix}/signals`, channels.length);
  channels.push({ id: channels.length, topic: `${prefix}/signals`, encoding: "json", schemaName: "Signals" });
}

const page = () => readFileSync(new URL("../../src/page/view.html", import.meta.url));
const server = createServer((request, response) => {
  const url = new URL(request.url, "http://localhost");
  const mesh = /^\/mesh\/(\d+)$/.exec(url.pathname);
  if (url.pathname === "/") response.setHeader("content-type", "text/html").end(page());
  else if (mesh && meshes[mesh[1]]) response.end(readFileSync(meshes[mesh[1]]));
  else response.writeHead(404).end();
});
const sockets = new WebSocketServer({ server, handleProtocols: protocols => [...protocols][0] });

let [time_s, speed, state, hand, handAt] = [0, 1, "playing", null, 0];
let largestGap_ms = 0;
const gains = Object.fromEntries(["x", "y", "z"].map(axis => [axis, { natural_frequency_rad_per_s: 14.1, damping_ratio: 1 }]));
const modes = { x: "compliant", y: "motion", z: "motion" };
const view = () => ({
  title: "compliant-x", kind: options.run ? "run" : "log", time_s, duration_s, speed, state, outcome: state === "ended" ? "completed" : null,
  late_cycles: 0, dropped_pictures: 0,
  robots: prefixes.map(prefix => ({
    prefix, name: "asimo-arm", label: `${prefix.slice(1) || "position"}, osc`, is_compared: true, same_base_as: prefix === prefixes[0] ? null : prefixes[0].slice(1), can_push: !!options.run,
    units: { "hand.position.x": "m", "hand.position.y": "m", "hand.position.z": "m", "operator.force.x": "N" },
    hand: hand && { frame: hand.frame, target_m: hand.target_m, stiffness_n_per_m: 500, damping_ns_per_m: 20, largest_force_n: 60, force_n: [12.3, 1, -4] },
    tasks: [{ name: "hand", frame: "hand", gains: options.run ? gains : null, modes: options.run ? modes : null }],
  })),
});
const send = (topic, data, id) => {
  for (const socket of sockets.clients) {
    const subscription = socket.subscriptions?.get(id ?? idOf.get(topic));
    if (subscription === undefined || socket.bufferedAmount > 1e6) continue;
    const head = Buffer.alloc(13);
    head[0] = 1;
    head.writeUInt32LE(subscription, 1);
    head.writeBigUInt64LE(begin_ns + BigInt(Math.round(time_s * 1e9)), 5);
    socket.send(Buffer.concat([head, data]));
  }
};
const sendView = () => send("/view", Buffer.from(JSON.stringify(view())), 0);
const signals = t => ({
  time_s: t,
  values: {
    "hand.position.x": 0.36 + 0.03 * Math.sin(3 * t), "hand.position.y": -0.04 + 0.004 * Math.sin(2 * t), "hand.position.z": -0.157,
    "operator.force.x": 3 * Math.sin(3 * t - 0.4), "operator.force.y": 0, "operator.force.z": 0, "q.elbow": -1.35 + 0.1 * Math.sin(t),
  },
});
/** Sends the last message of each topic up to the present time. */
function picture(from_s) {
  prefixes.forEach((prefix, i) => {
    const until = begin_ns + BigInt(Math.round(Math.max(0, time_s - 0.3 * i) * 1e9));
    const since = begin_ns + BigInt(Math.round(Math.max(0, from_s - 0.3 * i) * 1e9));
    const last = new Map();
    for (const message of moving) if (message.ns <= until && message.ns >= since - 120_000_000n) last.set(message.topic, message);
    for (const [topic, message] of last) send(prefix + topic, message.data);
    send(`${prefix}/signals`, Buffer.from(JSON.stringify(signals(time_s))));
  });
}
let last_ms = performance.now();
setInterval(() => {
  const now = performance.now();
  const dt_s = (now - last_ms) * 1e-3;
  last_ms = now;
  if (hand && now - handAt > 50) {
    console.log(`no message of the hand for ${(now - handAt).toFixed(1)} ms`);
    hand = null;
  }
  if (state === "playing") {
    const from_s = time_s;
    time_s = Math.min(duration_s, time_s + dt_s * speed);
    if (time_s === duration_s) state = "ended";
    picture(from_s);
    sendView();
  } else if (hand) sendView();
}, 20);
setInterval(sendView, 1000);

sockets.on("connection", socket => {
  socket.subscriptions = new Map();
  socket.send(JSON.stringify({ op: "serverInfo", name: "opspace", capabilities: ["clientPublish", "time"], supportedEncodings: ["json"], sessionId: "1" }));
  socket.send(JSON.stringify({ op: "advertise", channels }));
  const published = new Map();
  socket.on("message", (data, isBinary) => {
    if (!isBinary) {
      const message = JSON.parse(data);
      if (message.op === "advertise") message.channels.forEach(channel => published.set(channel.id, channel.topic));
      if (message.op === "subscribe") {
        message.subscriptions.forEach(({ id, channelId }) => socket.subscriptions.set(channelId, id));
        for (const prefix of prefixes) once.forEach(m => idOf.has(prefix + m.topic) && send(prefix + m.topic, m.data));
        picture(time_s);
        sendView();
      }
      return;
    }
    const topic = published.get(data.readUInt32LE(1));
    const message = JSON.parse(data.subarray(5));
    if (topic === "/hand") {
      if (hand) largestGap_ms = Math.max(largestGap_ms, performance.now() - handAt);
      if (message.release) {
        console.log(`released; largest time between two messages of the hand: ${largestGap_ms.toFixed(1)} ms`);
        largestGap_ms = 0;
      }
      hand = message.release ? null : message;
      handAt = performance.now();
    } else if (message.op === "play") state = "playing";
    else if (message.op === "pause") state = "paused";
    else if (message.op === "restart") [time_s, state] = [0, "playing"];
    else if (message.op === "speed") speed = message.value;
    else if (message.op === "seek") {
      time_s = message.time_s;
      if (state === "ended") state = "paused";
      picture(time_s);
    } else if (message.op === "step") picture((time_s += 0.001) - 0.001);
    else if (message.op === "gains") Object.assign(gains[message.axis], { natural_frequency_rad_per_s: message.natural_frequency_rad_per_s, damping_ratio: message.damping_ratio });
    else if (message.op === "mode") modes[message.axis] = message.mode;
    else socket.send(JSON.stringify({ op: "status", level: 1, message: `not understood: ${JSON.stringify(message)}` }));
    sendView();
  });
});
server.listen(Number(port), "127.0.0.1", () => console.log(`http://127.0.0.1:${port}/`));
