// Elements from plain values. Text is always text: names of recordings, rigs and people are never markup.

export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "dataset") Object.assign(element.dataset, value);
    else if (name in element && name !== "list") element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

// Set a text only if it has changed, so that a screen reader reads it once.
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

// The stage of some work, which a screen reader reads once, and a bar for its share.
export function showStage(place, text, share) {
  let bar = place.querySelector("progress");
  if (bar?.ariaLabel !== text) {
    bar = make("progress", { max: 1, ariaLabel: text });
    place.replaceChildren(text, bar);
  }
  bar.hidden = share === undefined;
  bar.value = share ?? 0;
}

// So many significant digits, without an exponent where none is needed.
export function written(value, digits = 4) {
  if (value === null || value === undefined) return "unknown";
  if (typeof value !== "number") return String(value);
  return String(Number(value.toPrecision(digits)));
}

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// A canvas in device pixels, cleared; returns its context and its size in CSS pixels.
export function cleared(canvas) {
  const ratio = devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}
