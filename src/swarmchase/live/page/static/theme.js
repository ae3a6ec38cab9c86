// The colours of the page, light or dark as the browser has it: page.css names them, what is painted asks here.

const LOOKS_LIGHT = window.matchMedia("(prefers-color-scheme: light)");

export function themeColor(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

export function trackerColor(index) {
  return themeColor(`tracker-${index}`);
}

export function onThemeChange(repaint) {
  LOOKS_LIGHT.addEventListener("change", repaint);
}
