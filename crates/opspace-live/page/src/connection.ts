//! Connection to the program: a client of Foxglove's WebSocket protocol, https://github.com/foxglove/ws-protocol.

interface Channel {
  id: number;
  topic: string;
  encoding: string;
  schemaName: string;
}

export interface Receiver {
  /** A message of a topic, with its time in the log, s. */
  message(topic: string, schema: string, payload: Uint8Array, log_s: number): void;
  /** The connection was made (again), or lost. */
  connected(isConnected: boolean): void;
  /** A remark of the server about what the page did. */
  status(text: string): void;
}

const PROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
const MESSAGE_DATA = 1;
const CLIENT_MESSAGE = 1;
/** Wait before the first attempt to connect again, and the longest, ms. */
const RETRY_MS = [250, 4000] as const;

export class Connection {
  private socket: WebSocket | undefined;
  private topics = new Map<number, { topic: string; schema: string }>();
  private channels: string[] = [];
  private retry_ms: number = RETRY_MS[0];

  /** `published` are the topics that the page writes. */
  constructor(private readonly url: string, private readonly published: string[], private readonly receiver: Receiver) {
    this.connect();
  }

  /** Publishes a message as JSON; nothing without a connection. */
  publish(topic: string, value: unknown): void {
    const id = this.channels.indexOf(topic);
    if (id < 0 || this.socket?.readyState !== WebSocket.OPEN) return;
    const text = new TextEncoder().encode(JSON.stringify(value));
    const frame = new Uint8Array(5 + text.length);
    frame[0] = CLIENT_MESSAGE;
    new DataView(frame.buffer).setUint32(1, id, true);
    frame.set(text, 5);
    this.socket.send(frame);
  }

  private connect(): void {
    const socket = new WebSocket(this.url, PROTOCOLS);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.retry_ms = RETRY_MS[0];
      this.topics.clear();
      this.channels = this.published;
      const channels = this.published.map((topic, id) => ({ id, topic, encoding: "json", schemaName: "" }));
      this.send({ op: "advertise", channels });
      this.receiver.connected(true);
    };
    socket.onmessage = event => {
      if (typeof event.data === "string") this.text(JSON.parse(event.data));
      else this.binary(new Uint8Array(event.data as ArrayBuffer));
    };
    socket.onclose = () => {
      this.receiver.connected(false);
      setTimeout(() => this.connect(), this.retry_ms);
      this.retry_ms = Math.min(RETRY_MS[1], 2 * this.retry_ms);
    };
  }

  private text(message: { op: string; channels?: Channel[]; channelIds?: number[]; message?: string }): void {
    if (message.op === "advertise") {
      // Subscriptions have the numbers of their channels.
      const channels = message.channels ?? [];
      channels.forEach(({ id, topic, schemaName }) => this.topics.set(id, { topic, schema: schemaName }));
      this.send({ op: "subscribe", subscriptions: channels.map(({ id }) => ({ id, channelId: id })) });
    } else if (message.op === "unadvertise") {
      message.channelIds?.forEach(id => this.topics.delete(id));
    } else if (message.op === "status") {
      this.receiver.status(message.message ?? "");
    }
  }

  private binary(frame: Uint8Array): void {
    if (frame[0] !== MESSAGE_DATA) return;
    const view = new DataView(frame.buffer);
    const source = this.topics.get(view.getUint32(1, true));
    const log_s = Number(view.getBigUint64(5, true)) * 1e-9;
    if (source) this.receiver.message(source.topic, source.schema, frame.subarray(13), log_s);
  }

  private send(message: unknown): void {
    this.socket?.send(JSON.stringify(message));
  }
}
