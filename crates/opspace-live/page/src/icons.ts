//! Icons of the controls.

const icon = (path: string) =>
  `<svg viewBox="0 0 24 24" width="20" height="20" fill="currentColor" aria-hidden="true"><path d="${path}"/></svg>`;

export const ICONS = {
  play: icon("M7 4.5v15l13-7.5z"),
  pause: icon("M6 4.5h4.2v15H6zM13.8 4.5H18v15h-4.2z"),
  step: icon("M5 4.5v15l10-7.5zM16.5 4.5H20v15h-3.5z"),
  restart: icon("M12 5V1.5L6.5 6.5 12 11.5V8a5.5 5.5 0 1 1-5.3 7H3.6A8.5 8.5 0 1 0 12 5z"),
  loop: icon("M7 7h9v3l5-4.5L16 1v3H5.5A1.5 1.5 0 0 0 4 5.5V12h3zm10 10H8v-3l-5 4.5L8 23v-3h10.5a1.5 1.5 0 0 0 1.5-1.5V12h-3z"),
  help: icon("M12 2a10 10 0 1 0 0 20 10 10 0 0 0 0-20zm1.1 16h-2.2v-2.2h2.2zm2.2-8.4-1 1c-.8.8-1.2 1.4-1.2 3h-2.2v-.5c0-1.1.4-2.1 1.2-2.9l1.3-1.3a1.8 1.8 0 1 0-3.1-1.3H8.1a4 4 0 1 1 7.2 2z"),
  frame: icon("M4 9V4h5V2H2v7zm11-7v2h5v5h2V2zm5 18h-5v2h7v-7h-2zM4 15H2v7h7v-2H4z"),
  panel: icon("M3 19h18v2H3zM3 3h2v14H3zm5 9 4-5 3 3 5-6 1.5 1.3L15.100 12.800 12 9.800 9.500 13z"),
};
