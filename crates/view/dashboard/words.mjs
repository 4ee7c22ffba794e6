// Formatting of numbers and durations, and elements of the page.

// Returns a field of a message as a number. In JSON, numbers of 64 bits are text, and zeros are omitted.
export const number = (value) => Number(value ?? 0);

export function duration(ms) {
  const s = Math.max(0, ms) / 1000;
  if (s < 10) return `${s.toFixed(1)} s`;
  if (s < 120) return `${Math.round(s)} s`;
  if (s < 7200) return `${Math.round(s / 60)} min`;
  return s < 172800 ? `${(s / 3600).toFixed(1)} h` : `${Math.round(s / 86400)} days`;
}

// Formats a large number with a unit, for example 1.2 M.
export function short(n) {
  for (const [size, unit] of [[1e12, 'T'], [1e9, 'G'], [1e6, 'M'], [1e3, 'k']]) {
    if (n >= size) return `${(n / size).toPrecision(3)} ${unit}`;
  }
  return n.toFixed(n < 10 && n % 1 ? 1 : 0);
}

// Formats the time of day, with the date if it is another day.
export function clock(ms) {
  const at = new Date(ms);
  return at.toDateString() === new Date().toDateString() ? at.toLocaleTimeString() : at.toLocaleString();
}

// The offset of the coordinator's clock, which may differ from this machine's clock, in milliseconds.
let ahead = 0;
export const setClock = (ms) => { ahead = ms - Date.now(); };
export const serverNow = () => Date.now() + ahead;

// Creates an element with text or children.
export function element(name, content, attributes = {}) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  for (const part of Array.isArray(content) ? content : [content]) made.append(part);
  return made;
}

export const byId = (id) => document.getElementById(id);
