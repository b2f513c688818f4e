//! Connection to the program: a client of Foxglove's WebSocket protocol, https://github.com/foxglove/ws-protocol. Its socket is in a worker.

import workerCode from "worker:./socket_worker.ts";
import type { Event, Order } from "./socket_worker.ts";

interface Channel {
  id: number;
  topic: string;
  encoding: string;
  schemaName: string;
}

export interface Receiver {
  /** A message of a topic. */
  message(topic: string, schema: string, payload: Uint8Array): void;
  /** The connection was made (again), or lost. */
  connected(isConnected: boolean): void;
  /** A remark of the server about what the page did. */
  status(text: string): void;
}

const PROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
const MESSAGE_DATA = 1;
const CLIENT_MESSAGE = 1;
/** Wait before the first attempt to connect again, and the longest, ms. */
const RETRY_MS = [250, 2000] as const;

export class Connection {
  private readonly worker: Worker;
  private readonly topics = new Map<number, { topic: string; schema: string; isJson: boolean }>();
  private isOpen = false;
  private retry_ms: number = RETRY_MS[0];

  /** `published` are the topics that the page writes. */
  constructor(private readonly url: string, private readonly published: string[], private readonly receiver: Receiver) {
    this.worker = new Worker(URL.createObjectURL(new Blob([workerCode], { type: "text/javascript" })));
    this.worker.onmessage = (event: MessageEvent<Event>) => this.receive(event.data);
    this.connect();
  }

  /** Publishes a message as JSON; nothing without a connection. */
  publish(topic: string, value: unknown): void {
    if (this.isOpen) this.order({ kind: "send", data: this.frame(topic, value) });
  }

  /** Publishes a message again and again, until the next call. */
  hold(topic: string, value: unknown): void {
    this.order({ kind: "hold", data: value === undefined ? undefined : this.frame(topic, value) });
  }

  private frame(topic: string, value: unknown): ArrayBuffer {
    const text = new TextEncoder().encode(JSON.stringify(value));
    const frame = new Uint8Array(5 + text.length);
    frame[0] = CLIENT_MESSAGE;
    new DataView(frame.buffer).setUint32(1, this.published.indexOf(topic), true);
    frame.set(text, 5);
    return frame.buffer;
  }

  private connect(): void {
    this.order({ kind: "connect", url: this.url, protocols: PROTOCOLS });
  }

  private receive(event: Event): void {
    if (event.kind === "open") {
      this.isOpen = true;
      this.retry_ms = RETRY_MS[0];
      this.topics.clear();
      const channels = this.published.map((topic, id) => ({ id, topic, encoding: "json", schemaName: "" }));
      this.send({ op: "advertise", channels });
      this.receiver.connected(true);
    } else if (event.kind === "close") {
      this.isOpen = false;
      this.receiver.connected(false);
      setTimeout(() => this.connect(), this.retry_ms);
      this.retry_ms = Math.min(RETRY_MS[1], 2 * this.retry_ms);
    } else if (event.kind === "text") {
      this.text(JSON.parse(event.data));
    } else {
      event.data.forEach(frame => this.binary(new Uint8Array(frame)));
      // The next messages come after the picture of these: nothing is decoded that is not seen.
      let isAnswered = false;
      const ready = () => {
        if (!isAnswered) this.order({ kind: "ready" });
        isAnswered = true;
      };
      requestAnimationFrame(ready);
      // A page in the background draws no pictures.
      setTimeout(ready, 100);
    }
  }

  private text(message: { op: string; channels?: Channel[]; channelIds?: number[]; message?: string }): void {
    if (message.op === "advertise") {
      // Subscriptions have the numbers of their channels.
      const channels = message.channels ?? [];
      for (const { id, topic, schemaName, encoding } of channels) {
        this.topics.set(id, { topic, schema: schemaName, isJson: encoding === "json" });
      }
      const json = [...this.topics].filter(([, { isJson }]) => isJson).map(([id]) => id);
      this.order({ kind: "keepAll", ids: json });
      this.send({ op: "subscribe", subscriptions: channels.map(({ id }) => ({ id, channelId: id })) });
    } else if (message.op === "unadvertise") {
      message.channelIds?.forEach(id => this.topics.delete(id));
    } else if (message.op === "status") {
      this.receiver.status(message.message ?? "");
    }
  }

  private binary(frame: Uint8Array): void {
    if (frame[0] !== MESSAGE_DATA || frame.length < 13) return;
    const source = this.topics.get(new DataView(frame.buffer).getUint32(1, true));
    if (source) this.receiver.message(source.topic, source.schema, frame.subarray(13));
  }

  private send(message: unknown): void {
    this.order({ kind: "send", data: JSON.stringify(message) });
  }

  private order(order: Order): void {
    this.worker.postMessage(order);
  }
}
