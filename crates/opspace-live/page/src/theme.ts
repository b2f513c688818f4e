//! Colours of the scene, light and dark.

export interface Theme {
  ink: number;
  ground: number;
  grid: number;
  shadow: number;
  /** Links of a single robot, alternately along the chain. */
  links: [number, number];
  force: number;
  hand: number;
  reference: number;
  wall: number;
  obstacle: number;
}

const LIGHT: Theme = {
  ink: 0x1c2024,
  ground: 0xf3f5f7,
  grid: 0xd3d9df,
  shadow: 0xdde2e8,
  links: [0xe9edf1, 0x7d8b99],
  force: 0xd55e00,
  hand: 0xb4308a,
  reference: 0x0072b2,
  wall: 0x8a94a3,
  obstacle: 0xc98a1b,
};

const DARK: Theme = {
  ink: 0xe6e8ea,
  ground: 0x15181b,
  grid: 0x30373e,
  shadow: 0x0c0e10,
  links: [0xd5dbe1, 0x76838f],
  force: 0xff8a3d,
  hand: 0xf078c8,
  reference: 0x4fb0f0,
  wall: 0x7b8694,
  obstacle: 0xe0a63a,
};

/** Colours of robots that are compared: distinct for colour-blind readers, on both backgrounds. */
const COMPARED = [0x2a8fd0, 0xe07b2a, 0x1f9e78, 0xc46bb0, 0xb09a1e];

export function comparedColor(index: number): number {
  return COMPARED[index % COMPARED.length]!;
}

const dark = matchMedia("(prefers-color-scheme: dark)");

export function theme(): Theme {
  return dark.matches ? DARK : LIGHT;
}

/** Calls `change` now and whenever the colour scheme changes. */
export function onTheme(change: (theme: Theme) => void): void {
  change(theme());
  dark.addEventListener("change", () => change(theme()));
}

export function css(color: number): string {
  return `#${color.toString(16).padStart(6, "0")}`;
}
