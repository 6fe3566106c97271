/** The icons of the bar: paths of 24 x 24. */

const PATHS = {
  play: "M8 5.5v13l10.5-6.5z",
  pause: "M7.5 5.5h3.2v13H7.5zM13.3 5.5h3.2v13h-3.2z",
  home: "M4 11.5 12 5l8 6.5M6.5 10v9h11v-9",
  share: "M10 14a4 4 0 0 0 6 .4l2.6-2.6a4 4 0 0 0-5.7-5.7L11.6 7.4M14 10a4 4 0 0 0-6-.4l-2.6 2.6a4 4 0 0 0 5.7 5.7l1.3-1.3",
  snapshot: "M4.5 8h3l1.5-2.5h6L16.5 8h3v10.5h-15zM12 16a3 3 0 1 0 0-6 3 3 0 0 0 0 6z",
  record: "M12 20a8 8 0 1 0 0-16 8 8 0 0 0 0 16zM12 14.5a2.5 2.5 0 1 0 0-5 2.5 2.5 0 0 0 0 5z",
  inspect: "M5 7h8M17 7h2M5 12h2M11 12h8M5 17h9M18 17h1M13 5v4M7 10v4M14 15v4",
  vr: "M3.5 8h17v8.5h-4.8L13.8 14h-3.6l-1.9 2.5H3.5zM8 12.3a1 1 0 1 0 0-2 1 1 0 0 0 0 2zM16 12.3a1 1 0 1 0 0-2 1 1 0 0 0 0 2z",
  full: "M4.5 9V4.5H9M15 4.5h4.5V9M19.5 15v4.5H15M9 19.5H4.5V15",
} as const;
export type Icon = keyof typeof PATHS;

const SVG = "http://www.w3.org/2000/svg";

export function setIcon(button: HTMLElement, icon: Icon): void {
  if (button.dataset.icon === icon) return;
  button.dataset.icon = icon;
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  if (icon === "play" || icon === "pause") svg.classList.add("solid");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", PATHS[icon]);
  svg.append(path);
  button.querySelector("svg")?.remove();
  button.prepend(svg);
}
