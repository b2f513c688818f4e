//! Decoder of protobuf messages: fields by number, as in https://protobuf.dev/programming-guides/encoding.

/** Values of one field: numbers, or bytes of texts and messages. */
type Value = number | Uint8Array;

const text = new TextDecoder();

export class Message {
  private readonly fields = new Map<number, Value[]>();

  constructor(bytes: Uint8Array) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    let at = 0;
    const varint = () => {
      let [value, factor] = [0, 1];
      for (;;) {
        const byte = view.getUint8(at++);
        value += (byte & 127) * factor;
        if (byte < 128) return value;
        factor *= 128;
      }
    };
    while (at < bytes.length) {
      const tag = varint();
      const [field, kind] = [Math.floor(tag / 8), tag & 7];
      let value: Value;
      if (kind === 0) value = varint();
      else if (kind === 1) {
        value = view.getFloat64(at, true);
        at += 8;
      } else if (kind === 2) {
        const length = varint();
        if (at + length > bytes.length) throw new RangeError("a field ends behind its message");
        value = bytes.subarray(at, at + length);
        at += length;
      } else if (kind === 5) {
        value = view.getFloat32(at, true);
        at += 4;
      } else throw new RangeError(`field of unknown kind ${kind}`);
      const values = this.fields.get(field);
      if (values) values.push(value);
      else this.fields.set(field, [value]);
    }
  }

  /** Number of a field; zero if it is absent, as proto3 has it. */
  number(field: number): number {
    const value = this.fields.get(field)?.at(-1);
    return typeof value === "number" ? value : 0;
  }

  text(field: number): string {
    const value = this.fields.get(field)?.at(-1);
    return value instanceof Uint8Array ? text.decode(value) : "";
  }

  message(field: number): Message {
    const value = this.fields.get(field)?.at(-1);
    return new Message(value instanceof Uint8Array ? value : new Uint8Array());
  }

  messages(field: number): Message[] {
    const values = this.fields.get(field) ?? [];
    return values.flatMap(value => (value instanceof Uint8Array ? [new Message(value)] : []));
  }
}
