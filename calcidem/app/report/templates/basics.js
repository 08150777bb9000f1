// What map and cells need: numbers, colours and the theme.
const byId = (id) => document.getElementById(id);
const escape = (text) => String(text).replace(/[&<>"]/g, (sign) => `&#${sign.charCodeAt(0)};`);
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const METHODS = ["peak", "first_arrival", "cross_correlation"];
const MISSING = "–";

function sums(steps) {
  let sum = 0;
  return steps.map((step) => (sum += step));
}

// Numbers and colours ------------------------------------------------------------------------------------------

function number(value, digits = 4) {
  if (value === null || value === undefined || value === "") return MISSING;
  if (typeof value !== "number") return String(value).replace("_", " ");
  const size = Math.abs(value);
  const exact = Number.isInteger(value) && size < 1e7;
  let text = String(exact ? value : Number(value.toPrecision(digits)));
  if (!exact && (size < 1e-3 || size >= 1e6)) text = value.toExponential(digits - 1);
  text = text.replace(/\.?0*e\+?(-?)(\d+)/, (_, sign, digits) => {
    return ` × 10${sign ? "⁻" : ""}${[...digits].map((digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]).join("")}`;
  });
  return text.replace(/^-/, "−");
}
const withUnit = (value, unit, digits = 4) => number(value, digits) + (typeof value === "number" && unit ? ` ${unit}` : "");
const percent = (share, digits = 2) => (typeof share === "number" ? `${number(100 * share, digits)} %` : MISSING);

const swatch = (colour) => `<span class="swatch" style="background:${colour}"></span>`;
const key = (colour, text) => `<span>${swatch(`var(--${colour})`)}${text}</span>`;

const probe = document.body.appendChild(Object.assign(document.createElement("span"), { hidden: true }));
/** A colour of the style sheet as a canvas takes it. */
function paint(name) {
  probe.style.color = `var(--${name})`;
  return getComputedStyle(probe).color;
}
const RISING = ["440154", "482878", "3e4989", "31688e", "26828e", "1f9e89", "35b779", "6ece58", "b5de2b", "fde725"];
const DIVERGING = ["2166ac", "67a9cf", "d1e5f0", "f7f7f7", "fddbc7", "ef8a62", "b2182b"];
const NAMED = ["#56b4e9", "#d55e00", "#e69f00", "#cc79a7", "#009e73", "#f0e442", "#0072b2", "#999999"];
function mix(stops, share) {
  const place = clamp(share, 0, 1) * (stops.length - 1);
  const low = Math.min(Math.floor(place), stops.length - 2);
  const part = (stop, at) => parseInt(stops[stop].slice(at, at + 2), 16);
  const tones = [0, 2, 4].map((at) => Math.round(part(low, at) + (place - low) * (part(low + 1, at) - part(low, at))));
  return `rgb(${tones})`;
}
function ticks(low, high, most) {
  const raw = (high - low) / Math.max(most, 1) || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= raw) * power;
  const found = [];
  for (let place = Math.ceil(low / step); place * step <= high + 1e-9 * step; place++) found.push(place * step);
  return found;
}
/** A canvas of a size in the page's pixels, sharp on every screen. */
function context(canvas, width, height) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  canvas.style.width = `${width}px`;
  canvas.style.height = `${height}px`;
  const drawn = canvas.getContext("2d");
  drawn.scale(ratio, ratio);
  drawn.font = "12px system-ui, sans-serif";
  return drawn;
}

// Boxes that scroll sideways -------------------------------------------------------------------------------------

const sizes = new ResizeObserver((changes) => changes.forEach(({ target }) => markEnds(target.closest(".ends > *"))));
/** Mark the ends of a box beyond which there is more of it. */
function markEnds(box) {
  const hidden = box.scrollWidth - box.clientWidth;
  box.parentElement.classList.toggle("goes-left", box.scrollLeft > 1);
  box.parentElement.classList.toggle("goes-right", box.scrollLeft < hidden - 1);
}
function watchEnds(box) {
  box.addEventListener("scroll", () => markEnds(box), { passive: true });
  for (const part of [box, box.firstElementChild]) sizes.observe(part);
}
document.querySelectorAll(".ends > *").forEach(watchEnds);

// Theme --------------------------------------------------------------------------------------------------------

const root = document.documentElement;
const prefersDark = matchMedia("(prefers-color-scheme: dark)");
let remembered = null;
try {
  remembered = localStorage.getItem("calcidem-theme");
} catch {
  // Pages opened from disk may have no storage; the switch then lasts as long as the page.
}
const isDark = () => (remembered ? remembered === "dark" : prefersDark.matches);
function showTheme() {
  root.style.colorScheme = isDark() ? "dark" : "light";
  root.toggleAttribute("data-dark", isDark());
  byId("theme").textContent = isDark() ? "light" : "dark";
  byId("theme").setAttribute("aria-label", `change to ${isDark() ? "light" : "dark"} colours`);
}
byId("theme").hidden = false;
byId("theme").addEventListener("click", () => {
  remembered = isDark() ? "light" : "dark";
  try {
    localStorage.setItem("calcidem-theme", remembered);
  } catch {
    // see above
  }
  showTheme();
  redraw();
});
prefersDark.addEventListener("change", () => {
  showTheme();
  redraw();
});
showTheme();
