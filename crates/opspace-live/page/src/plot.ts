//! Plots on a canvas: lines over time with one cursor, and one quantity over another.

export interface Line {
  label: string;
  color: string;
  x: number[];
  y: number[];
}

export interface PlotContent {
  title: string;
  xLabel: string;
  lines: Line[];
  /** Range of the abscissa; that of the values if absent. */
  xRange?: [number, number];
  /** Abscissa of the cursor. */
  cursor?: number | undefined;
  /** Marks the last point of each line. */
  hasHead?: boolean;
}

const LEFT = 46;
const RIGHT = 10;
const TOP = 8;
const BOTTOM = 34;
const TICKS = 4;
/** Points of a line: more than there are pixels. */
const MOST_POINTS = 600;

export class Plot {
  readonly element = document.createElement("figure");
  private readonly canvas = document.createElement("canvas");
  private readonly legend = document.createElement("figcaption");
  private content: PlotContent | undefined;
  private xs: [number, number] = [0, 1];

  /** `pointed` is called with the abscissa under the pointer. */
  constructor(private readonly height_px: number, pointed: (x: number | undefined) => void = () => {}) {
    this.element.className = "plot";
    this.element.append(this.legend, this.canvas);
    this.canvas.setAttribute("role", "img");
    this.canvas.addEventListener("pointermove", event => {
      const width = this.canvas.clientWidth - LEFT - RIGHT;
      const share = (event.offsetX - LEFT) / Math.max(1, width);
      pointed(share < 0 || share > 1 ? undefined : this.xs[0] + share * (this.xs[1] - this.xs[0]));
    });
    this.canvas.addEventListener("pointerleave", () => pointed(undefined));
    new ResizeObserver(() => this.content && this.draw(this.content)).observe(this.element);
  }

  draw(content: PlotContent): void {
    this.content = content;
    const width = this.element.clientWidth;
    if (width === 0) return;
    this.writeLegend(content);
    const ratio = devicePixelRatio;
    const [w, h] = [Math.round(width * ratio), Math.round(this.height_px * ratio)];
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    this.canvas.style.height = `${this.height_px}px`;
    // Thin lines are drawn faster by the processor, above all where there is no other.
    const context = this.canvas.getContext("2d", { willReadFrequently: true })!;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, this.height_px);
    const style = getComputedStyle(this.element);
    const [ink, rule] = [style.getPropertyValue("--soft"), style.getPropertyValue("--line")];
    this.xs = content.xRange ?? range(content.lines.map(line => line.x));
    const inside = (line: Line) => line.y.filter((_, i) => line.x[i]! >= this.xs[0] && line.x[i]! <= this.xs[1]);
    const ys = range(content.lines.map(inside));
    const [right, bottom] = [width - RIGHT, this.height_px - BOTTOM];
    const x = (value: number) => LEFT + ((value - this.xs[0]) / (this.xs[1] - this.xs[0])) * (right - LEFT);
    const y = (value: number) => bottom - ((value - ys[0]) / (ys[1] - ys[0])) * (bottom - TOP);

    context.font = "12px system-ui, sans-serif";
    context.lineWidth = 1;
    context.textBaseline = "middle";
    context.textAlign = "right";
    for (const tick of ticks(ys)) {
      stroke(context, rule, [[LEFT, y(tick)], [right, y(tick)]]);
      context.fillStyle = ink;
      context.fillText(short(tick), LEFT - 6, y(tick));
    }
    context.textAlign = "center";
    for (const tick of ticks(this.xs)) {
      if (!content.xRange) stroke(context, rule, [[x(tick), TOP], [x(tick), bottom]]);
      context.fillText(short(tick), x(tick), bottom + 10);
    }
    context.textAlign = "right";
    context.fillText(content.xLabel, right, bottom + 26);
    context.save();
    context.beginPath();
    context.rect(LEFT - 1, TOP - 1, right - LEFT + 2, bottom - TOP + 2);
    context.clip();
    context.lineWidth = 1.6;
    for (const line of content.lines) {
      const step = Math.ceil(line.x.length / MOST_POINTS);
      const points: [number, number][] = [];
      for (let i = 0; i < line.x.length; i += step) points.push([x(line.x[i]!), y(line.y[i]!)]);
      stroke(context, line.color, points);
      const last = line.x.length - 1;
      if (!content.hasHead || last < 0) continue;
      context.fillStyle = line.color;
      context.beginPath();
      context.arc(x(line.x[last]!), y(line.y[last]!), 3.5, 0, 7);
      context.fill();
    }
    context.lineWidth = 1;
    if (content.cursor !== undefined) stroke(context, ink, [[x(content.cursor), TOP], [x(content.cursor), bottom]]);
    context.restore();
  }

  /** Title, and each line with its value at the cursor or its last one. */
  private writeLegend({ title, lines, cursor }: PlotContent): void {
    const items = lines.map(line => {
      const at = cursor === undefined ? line.x.length - 1 : nearest(line.x, cursor);
      return { label: line.label, color: line.color, value: line.y[at] };
    });
    const text = `${title}: ${items.map(({ label, value }) => `${label} ${short(value ?? NaN)}`).join(", ")}`;
    this.canvas.setAttribute("aria-label", text);
    const name = document.createElement("b");
    name.textContent = title;
    const entries = items.map(({ label, color, value }) => {
      const entry = document.createElement("span");
      entry.style.setProperty("--color", color);
      entry.textContent = `${label} ${value === undefined ? "" : value.toPrecision(3).replace("-", "−")}`;
      return entry;
    });
    this.legend.replaceChildren(name, ...entries);
  }
}

function stroke(context: CanvasRenderingContext2D, color: string, points: [number, number][]): void {
  context.strokeStyle = color;
  context.beginPath();
  points.forEach(([x, y], i) => (i === 0 ? context.moveTo(x, y) : context.lineTo(x, y)));
  context.stroke();
}

function range(columns: number[][]): [number, number] {
  let [low, high] = [Infinity, -Infinity];
  for (const column of columns) {
    for (const value of column) {
      if (!Number.isFinite(value)) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  if (low > high) return [0, 1];
  const margin = 0.06 * (high - low) || 0.5 * Math.abs(high) || 0.5;
  return [low - margin, high + margin];
}

/** Round numbers within a range. */
function ticks([low, high]: [number, number]): number[] {
  const rough = (high - low) / TICKS;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5, 10].find(factor => factor * power >= rough) ?? 10);
  const found: number[] = [];
  for (let i = Math.ceil(low / step); i * step <= high; i++) found.push(i * step);
  return found;
}

function short(value: number): string {
  if (!Number.isFinite(value)) return "–";
  return `${Number(value.toPrecision(4))}`.replace("-", "−");
}

function nearest(sorted: number[], value: number): number {
  let [low, high] = [0, sorted.length - 1];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle]! < value) low = middle + 1;
    else high = middle;
  }
  return low;
}
