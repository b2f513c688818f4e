//! Worker that owns the WebSocket: the hand's messages are in time while the page draws, and a page that draws slowly gets the last message of
//! each topic instead of a growing queue.

/** From the page. */
export type Order =
  | { kind: "connect"; url: string; protocols: string[] }
  | { kind: "send"; data: string | ArrayBuffer }
  /** Repeats a message until the next order of this kind. */
  | { kind: "hold"; data: ArrayBuffer | undefined }
  /** Messages of these subscriptions are all delivered. */
  | { kind: "keepAll"; ids: number[] }
  /** The page has shown what it got. */
  | { kind: "ready" };

/** To the page. */
export type Event =
  | { kind: "open" }
  | { kind: "close" }
  | { kind: "text"; data: string }
  | { kind: "messages"; data: ArrayBuffer[] };

const REPEAT_MS = 10;
/** A page that has not repeated its order for this long hangs: the hand lets go, ms. */
const HUNG_MS = 400;
/** Most messages of a subscription that wait for the page. */
const MOST_WAITING = 500;

const scope = self as unknown as { postMessage(event: Event, transfer?: Transferable[]): void; onmessage: ((event: MessageEvent<Order>) => void) | null };
let socket: WebSocket | undefined;
let held: ArrayBuffer | undefined;
let heldAt_ms = 0;
let keepAll = new Set<number>();
let isReady = true;
const waiting = new Map<number, ArrayBuffer[]>();

setInterval(() => {
  if (!held || performance.now() - heldAt_ms > HUNG_MS) return;
  send(held);
}, REPEAT_MS);

scope.onmessage = ({ data: order }) => {
  if (order.kind === "connect") connect(order.url, order.protocols);
  else if (order.kind === "send") send(order.data);
  else if (order.kind === "keepAll") keepAll = new Set(order.ids);
  else if (order.kind === "ready") {
    isReady = true;
    deliver();
  } else {
    held = order.data;
    heldAt_ms = performance.now();
    if (held) send(held);
  }
};

function connect(url: string, protocols: string[]): void {
  socket = new WebSocket(url, protocols);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => scope.postMessage({ kind: "open" });
  socket.onclose = () => {
    held = undefined;
    waiting.clear();
    scope.postMessage({ kind: "close" });
  };
  socket.onmessage = ({ data }) => {
    if (typeof data === "string") {
      scope.postMessage({ kind: "text", data });
      return;
    }
    const buffer = data as ArrayBuffer;
    if (buffer.byteLength < 5) return;
    const id = new DataView(buffer).getUint32(1, true);
    const messages = keepAll.has(id) ? (waiting.get(id) ?? []) : [];
    messages.push(buffer);
    if (messages.length > MOST_WAITING) messages.shift();
    waiting.set(id, messages);
    if (isReady) deliver();
  };
}

function deliver(): void {
  const data = [...waiting.values()].flat();
  waiting.clear();
  if (data.length === 0) return;
  isReady = false;
  scope.postMessage({ kind: "messages", data }, data);
}

function send(data: string | ArrayBuffer): void {
  if (socket?.readyState === WebSocket.OPEN) socket.send(data);
}
