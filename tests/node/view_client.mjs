// Reads a live view with Foxglove's own client, `@foxglove/ws-protocol`.
//
// usage: node view_client.mjs ws://HOST:PORT/ TOPIC...
//
// Prints the topics with their types. Decodes messages with the schemas that the view announces. Fails if a topic is missing, if
// `/tf` has no transforms, or if the view does not answer to the hand.

import wsProtocol from "@foxglove/ws-protocol";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor.js";
import { WebSocket } from "ws";

const { FoxgloveClient } = wsProtocol;
const PATIENCE_MS = 20_000;
const [address, ...topics] = process.argv.slice(2);

/** Decoder of the messages of a channel, from its schema. */
function decoder(channel) {
  if (channel.encoding === "json") {
    return (data) => JSON.parse(new TextDecoder().decode(data));
  }
  if (channel.encoding !== "protobuf") {
    return (data) => new TextDecoder().decode(new Uint8Array(data.buffer, data.byteOffset + 8, data.byteLength - 9));
  }
  const files = descriptor.FileDescriptorSet.decode(Buffer.from(channel.schema, "base64"));
  const type = protobuf.Root.fromDescriptor(files).resolveAll().lookupType(channel.schemaName);
  return (data) => type.toObject(type.decode(new Uint8Array(data.buffer, data.byteOffset, data.byteLength)));
}

const client = new FoxgloveClient({ ws: new WebSocket(address, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
const decoders = new Map();
const last = new Map();
let isPulled = false;
const fail = (what) => {
  console.error(what);
  process.exit(1);
};
setTimeout(() => {
  const missing = topics.filter((topic) => !last.has(topic));
  fail(`no message of ${missing.join(", ") || "the hand"}`);
}, PATIENCE_MS);

client.on("error", (error) => fail(`error: ${error.message ?? error}`));
client.on("status", (status) => fail(`the view warns: ${status.message}`));
client.on("serverInfo", (info) => {
  console.log(`${info.name}: ${info.capabilities.join(", ")}`);
  const channel = client.advertise({ topic: "/hand", encoding: "json", schemaName: "" });
  const hand = { frame: "hand", point_m: [0, 0, 0], target_m: [0.4, 0, -0.1] };
  setInterval(() => client.sendMessage(channel, new TextEncoder().encode(JSON.stringify(hand))), 15);
});
client.on("advertise", (channels) => {
  for (const channel of channels) {
    console.log(`${channel.topic}: ${channel.schemaName} (${channel.encoding})`);
    decoders.set(client.subscribe(channel.id), [channel.topic, decoder(channel)]);
  }
});
client.on("message", ({ subscriptionId, data }) => {
  const [topic, decode] = decoders.get(subscriptionId);
  const message = decode(data);
  last.set(topic, message);
  if (topic === "/tf" && !(message.transforms?.length > 0 && message.transforms[0].childFrameId)) {
    fail(`no transforms: ${JSON.stringify(message)}`);
  }
  if (topic === "/robot_description" && !message.includes("<robot")) {
    fail("no URDF");
  }
  if (topic === "/view") {
    const [robot] = message.robots;
    isPulled ||= robot?.hand != null && Math.hypot(...robot.hand.force_n) > 1;
  }
  if (isPulled && topics.every((topic) => last.has(topic))) {
    const [x, y, z] = ["x", "y", "z"].map((axis) => last.get("/view").robots[0].hand?.force_n["xyz".indexOf(axis)]);
    console.log(`pulled with ${x}, ${y}, ${z} N; ${last.get("/tf").transforms.length} transforms`);
    process.exit(0);
  }
});
