// Helpers for elements, keyed lists and local storage.

export const $ = (id) => document.getElementById(id);

export function element(tag, text = '', values = {}) {
  const e = Object.assign(document.createElement(tag), values);
  if (text) e.textContent = text;
  return e;
}

// Returns a name in which lines may break after `_`, `-`, `.` and `/`, rather than within a word.
export function nameElement(name) {
  const e = element('span');
  e.append(...name.split(/(?<=[-_./])(?=.)/).flatMap((part, k) => (k ? [document.createElement('wbr'), part] : [part])));
  return e;
}

// Shows items as children of a parent. Elements are reused by key: an update must not replace an element while it is pressed.
export function keyed(parent, items, key, make, update) {
  const old = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  const children = items.map((item) => {
    const name = key(item), child = old.get(name) || make(item);
    child.dataset.key = name;
    update(child, item);
    return child;
  });
  if (children.length !== parent.children.length || children.some((child, k) => parent.children[k] !== child)) parent.replaceChildren(...children);
}

export function remembered(name, otherwise) {
  try { return JSON.parse(localStorage.getItem(name)) ?? otherwise; } catch { return otherwise; }
}

export function remember(name, value) { try { localStorage.setItem(name, JSON.stringify(value)); } catch { /* unavailable in private windows */ } }

let listener = () => {};
// Calls a function with the text of each note, and whether it is bad.
export function onNote(call) { listener = call; }

export function note(text, bad = false) {
  listener(text, bad);
  const p = element('p', text, { className: bad ? 'bad' : '' });
  $('notes').append(p);
  while ($('notes').children.length > 4) $('notes').firstChild.remove();
  setTimeout(() => p.remove(), 5000);
}

export function download(blob, name) {
  const a = element('a', '', { href: URL.createObjectURL(blob), download: name });
  a.click();
  setTimeout(() => URL.revokeObjectURL(a.href), 1000);
}

export const fileName = (text) => text.replace(/[^\w-]+/g, '_').replace(/^_+|_+$/g, '') || 'image';
