"""How well what is written on the page stands out from what is below it (WCAG 2.2, 1.4.3), in a browser."""

from typing import Any

LEAST_CONTRAST = 4.5
LEAST_CONTRAST_OF_LINES = 3.0
"""1.4.11: of what is no text."""
SCHEMES = ("dark", "light")
PAINTED = """
// Texts on canvases, where no element has them: the newest of each, with what it was outlined with, in which scheme.
window.painted = {};
window.isLight = () => window.matchMedia("(prefers-color-scheme: light)").matches;
const texts = CanvasRenderingContext2D.prototype;
const [fillText, strokeText] = [texts.fillText, texts.strokeText];
const outlines = new WeakMap();
texts.strokeText = function (text, ...rest) {
  outlines.set(this, { text, color: this.strokeStyle });
  return strokeText.call(this, text, ...rest);
};
texts.fillText = function (text, ...rest) {
  const before = outlines.get(this);
  const outline = before?.text === text ? before.color : null;
  const words = `${this.canvas.closest("[id]")?.id ?? "label"}: ${text}`;
  window.painted[words] = { color: this.fillStyle, outline, canvas: this.canvas, isLight: window.isLight() };
  return fillText.call(this, text, ...rest);
};
"""
"""Before anything of the page runs."""
_MEASURES = """
  // sRGB by the canvas, so that every way to write a colour is understood.
  const context = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
  const rgba = (text) => {
    context.clearRect(0, 0, 1, 1);
    context.fillStyle = text;
    context.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = context.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = ([r, g, b, a], [R, G, B]) => [r * a + R * (1 - a), g * a + G * (1 - a), b * a + B * (1 - a), 1];
  const ground = (element) => {
    const own = rgba(getComputedStyle(element).backgroundColor);
    if (own[3] === 1) return own;
    return over(own, element.parentElement ? ground(element.parentElement) : [255, 255, 255, 1]);
  };
  const luminance = ([r, g, b]) => [r, g, b]
    .map((one) => one / 255)
    .map((one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4))
    .reduce((sum, one, index) => sum + one * [0.2126, 0.7152, 0.0722][index], 0);
  const contrast = (one, other) => {
    const [low, high] = [luminance(one), luminance(other)].sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05);
  };
"""
_OF_TEXTS = f"""
() => {{
  {_MEASURES}
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {{
    const element = walker.currentNode.parentElement;
    const text = walker.currentNode.textContent.trim();
    if (!text || !element.checkVisibility() || element.closest(".unseen, option")) continue;
    const grounds = [ground(element)];
    const fill = element.closest(".bar, #abort")?.querySelector(".fill, .lasting");
    if (fill) grounds.push(rgba(getComputedStyle(fill).backgroundColor));
    for (const one of grounds) found.push([contrast(over(rgba(getComputedStyle(element).color), one), one), text]);
  }}
  for (const [text, {{ color, outline, canvas, isLight }}] of Object.entries(window.painted ?? {{}})) {{
    if (isLight !== window.isLight()) continue;
    const below = outline ? rgba(outline) : ground(canvas.parentElement);
    found.push([contrast(over(rgba(color), below), below), text]);
  }}
  return found;
}}
"""


_OF_COLORS = f"""
([names, below]) => {{
  {_MEASURES}
  const color = (name) => rgba(getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim());
  return Object.fromEntries(names.map((name) => [name, contrast(color(name), color(below))]));
}}
"""


def contrasts(page: Any) -> list[tuple[float, str]]:
    """Of every text that is shown, as it is now; with ``PAINTED`` also of those on canvases."""
    return [(ratio, text) for ratio, text in page.evaluate(_OF_TEXTS)]


def places_painted(page: Any) -> set[str]:
    """Where texts on canvases have been painted in the scheme of now."""
    newest = "Object.entries(window.painted).filter(([, one]) => one.isLight === window.isLight())"
    return {words.partition(":")[0] for words in page.evaluate(f"{newest}.map(([words]) => words)")}


def contrasts_of_colors(page: Any, names: list[str], below: str) -> dict[str, float]:
    """Of these colours of the page's style over another one."""
    found: dict[str, float] = page.evaluate(_OF_COLORS, [names, below])
    return found
