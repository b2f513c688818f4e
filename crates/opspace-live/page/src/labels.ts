//! Texts at points of the scene, as elements over the canvas: sharp at any size, and readable by assistive programs.

import { Object3D, PerspectiveCamera, Vector3 } from "three";

interface Label {
  element: HTMLElement;
  at: Object3D;
  offset: Vector3;
}

const point = new Vector3();
/** Height of a line of text, and about the width of a letter. */
const LINE_PX = 16;
const LETTER_PX = 8;
/** Least distance from the upper edge. */
const TOP_PX = 18;

export class Labels {
  private readonly labels = new Set<Label>();

  constructor(private readonly layer: HTMLElement) {}

  /** Adds a text at a point that is fixed to an object. Its colour is a style rule of the page, by class. */
  add(text: string, at: Object3D, kind: string, offset = new Vector3()): Label {
    const element = document.createElement("span");
    element.className = `label ${kind}`;
    element.textContent = text;
    this.layer.append(element);
    const label = { element, at, offset };
    this.labels.add(label);
    return label;
  }

  remove(label: Label): void {
    label.element.remove();
    this.labels.delete(label);
  }

  /** Moves all texts to their points; one that would cover another one moves below it. */
  place(camera: PerspectiveCamera, width_px: number, height_px: number): void {
    const taken: [number, number, number][] = [];
    for (const { element, at, offset } of this.labels) {
      let shown = element.textContent !== "";
      for (let node: Object3D | null = at; node; node = node.parent) shown &&= node.visible;
      point.copy(offset).applyMatrix4(at.matrixWorld).project(camera);
      shown &&= Math.abs(point.z) < 1 && Math.abs(point.x) < 1.1 && Math.abs(point.y) < 1.1;
      element.hidden = !shown;
      if (!shown) continue;
      const width = LETTER_PX * element.textContent!.length;
      const x = Math.min((point.x + 1) * 0.5 * width_px, width_px - width - 14);
      let y = Math.max(TOP_PX, (1 - point.y) * 0.5 * height_px);
      const right = x + width;
      const covers = ([left, end, top]: [number, number, number]) => x < end && right > left && Math.abs(y - top) < LINE_PX;
      for (let other = taken.find(covers); other; other = taken.find(covers)) y = other[2] + LINE_PX + 1;
      taken.push([x, right, y]);
      element.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    }
  }
}

export type { Label };
