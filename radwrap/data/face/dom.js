// Elements of the page; text goes in as text, whatever it holds.

/**
 * The element of an id that the page has.
 * @template {HTMLElement} T
 * @param {string} id
 * @param {new () => T} [kind]
 * @returns {T}
 */
export function byId(id, kind) {
  const found = document.getElementById(id);
  if (!found || (kind && !(found instanceof kind))) throw new Error(`the page lacks #${id}`);
  return /** @type {T} */ (found);
}

/**
 * The number in a field. Where there is none that fits, it is the one before, and the field is marked.
 * @param {string} id
 * @param {(value: number) => boolean} fits
 */
export function numberOf(id, fits) {
  const field = byId(id, HTMLInputElement);
  const value = field.value.trim() === "" ? NaN : Number(field.value);
  const good = Number.isFinite(value) && fits(value);
  if (good) {
    field.dataset.used = field.value;
    field.removeAttribute("aria-invalid");
  } else field.setAttribute("aria-invalid", "true");
  return good ? value : Number(field.dataset.used ?? field.defaultValue);
}

/** A field that is left shows the number that counts. @param {string} id */
export function settle(id) {
  const field = byId(id, HTMLInputElement);
  if (field.getAttribute("aria-invalid") !== "true") return;
  field.value = field.dataset.used ?? field.defaultValue;
  field.removeAttribute("aria-invalid");
}

/**
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} name
 * @param {Record<string, string>} attributes
 * @param {...(Node | string)} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/**
 * @param {string} name
 * @param {Record<string, string>} attributes
 * @param {...Node} children
 */
export function drawing(name, attributes, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/**
 * A table of texts.
 * @param {string} caption
 * @param {string[]} head
 * @param {(string | number)[][]} rows
 */
export function tableOf(caption, head, rows) {
  const titles = element("tr", {}, ...head.map((text) => element("th", { scope: "col" }, text)));
  const lines = rows.map(([first, ...rest]) => element("tr", {}, element("th", { scope: "row" }, String(first)),
    ...rest.map((cell) => element("td", {}, String(cell)))));
  return element("table", {}, element("caption", { class: "hidden" }, caption), element("thead", {}, titles),
    element("tbody", {}, ...lines));
}

/**
 * Give a file to the user.
 * @param {BlobPart} content
 * @param {string} name
 * @param {string} type
 */
export function download(content, name, type) {
  const url = URL.createObjectURL(new Blob([content], { type }));
  const link = element("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

let down = false;
if (typeof document !== "undefined") {
  document.addEventListener("pointerdown", () => { down = true; }, { capture: true });
  for (const name of ["pointerup", "pointercancel"]) document.addEventListener(name, () => { down = false; }, { capture: true });
}

/** Whether a button of the pointer is held down. */
export function pressed() {
  return down;
}

/** The knob that has the focus, and what is typed into it. */
export function focusedKnob() {
  const { activeElement: active } = document;
  const knob = active instanceof HTMLInputElement ? active.closest("[data-knob]")?.getAttribute("data-knob") : null;
  return knob && active instanceof HTMLInputElement ? { knob, type: active.type, text: active.value } : null;
}

/** @param {{knob: string, type: string, text: string}} focus */
export function focusKnob({ knob, type, text }) {
  const row = [...document.querySelectorAll("[data-knob]")].find((one) => one.getAttribute("data-knob") === knob);
  const field = row?.querySelector(`input[type=${type}]`);
  if (!(field instanceof HTMLInputElement)) return;
  if (type === "text") field.value = text;
  field.focus();
}
