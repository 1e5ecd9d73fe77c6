// The arrangement of the panels: nested splits of tab groups that fill the window, kept in the browser.
// A node is { split: 'row' | 'column', at: [share, ...], of: [node, ...] } or { tabs: [entry, ...], shown: entry }; an entry names a panel, or
// several that are stacked, joined by '+'. A node with `side` can be hidden by name.
import { $, element, remember, remembered } from './dom.js';

const group = (...tabs) => ({ tabs, shown: tabs[0] });
const DESKTOP = () => ({
  split: 'row', at: [0.17, 0.46, 0.37], of: [
    { split: 'column', at: [0.55, 0.45], side: 'left', of: [group('scene'), group('inspector', 'task')] },
    { split: 'column', at: [0.67, 0.33], of: [
      group('images'),
      { split: 'row', at: [0.64, 0.36], side: 'bottom', of: [group('plots', 'log', 'recordings'), group('drive')] },
    ] },
    { split: 'column', at: [0.53, 0.47], side: 'right', of: [group('map'), group('view3d')] },
  ],
});
const PHONE = () => group('images+drive', 'map', 'view3d', 'scene+inspector', 'plots', 'task+log+recordings');
const TITLES = { 'images+drive': 'Drive', 'scene+inspector': 'Scene', 'task+log+recordings': 'More' };
const PANELS = ['images', 'map', 'view3d', 'scene', 'inspector', 'drive', 'plots', 'log', 'recordings', 'task'];
const PANEL = Object.fromEntries(PANELS.map((name) => [name, $(`panel-${name}`)])); // also while they are in no document
const NARROW = matchMedia('(max-width: 760px), (max-height: 500px)');
const LEAST = 0.06; // smallest share of a split
const STEP = 0.02; // share that an arrow key moves a splitter by
const DRAG = 8; // pixels: a tab that moves less is pressed
const EDGE = 0.25; // part of a group at whose edge a dropped tab splits it

const title = (entry) => TITLES[entry] || PANEL[entry].dataset.title;
const panelsOf = (node) => (node.tabs ? node.tabs.flatMap((entry) => entry.split('+')) : node.of.flatMap(panelsOf));

function isValid(node) {
  if (!node || typeof node !== 'object') return false;
  if (node.tabs) return Array.isArray(node.tabs) && node.tabs.length > 0 && node.tabs.every((e) => PANELS.includes(e)) && node.tabs.includes(node.shown);
  return ['row', 'column'].includes(node.split) && Array.isArray(node.of) && node.of.length > 1 && Array.isArray(node.at) && node.at.length === node.of.length
    && node.at.every((share) => share > 0 && share < 1) && node.of.every(isValid);
}

export class Layout {
  // onChange is called after every change of what is visible.
  constructor(dock, onChange) {
    this.dock = dock; this.onChange = onChange; this.hiddenSides = new Set(remembered('hidden-sides', [])); this.largest = '';
    const kept = remembered('layout', null);
    this.desktop = isValid(kept) && panelsOf(kept).sort().join() === [...PANELS].sort().join() ? kept : DESKTOP();
    this.phone = PHONE();
    NARROW.addEventListener('change', () => this.build());
    for (const side of ['left', 'bottom', 'right']) $(`side-${side}`).onclick = () => this.toggleSide(side);
    $('layout-reset').onclick = () => { this.desktop = DESKTOP(); this.hiddenSides.clear(); this.save(); this.build(); };
    dock.addEventListener('keydown', (event) => { if (event.key === 'Escape' && this.largest) this.enlarge(''); });
    this.build();
  }

  get isNarrow() { return NARROW.matches; }

  get root() { return this.isNarrow ? this.phone : this.desktop; }

  save() { remember('layout', this.desktop); remember('hidden-sides', [...this.hiddenSides]); }

  // Returns whether a panel is in view, not behind another tab.
  visible(panel) { return !this.showing.has(panel) ? false : !this.largest || this.largestGroup().includes(panel); }

  largestGroup() { const node = this.groupOf(this.largest); return node ? node.shown.split('+') : []; }

  // Returns the tab group with a panel.
  groupOf(panel, node = this.root) {
    if (node.tabs) return node.tabs.some((entry) => entry.split('+').includes(panel)) ? node : null;
    for (const child of node.of) { const found = this.groupOf(panel, child); if (found) return found; }
    return null;
  }

  // Brings a panel to the front, and shows its side.
  show(panel) {
    const node = this.groupOf(panel);
    if (!node) return;
    const entry = node.tabs.find((e) => e.split('+').includes(panel));
    if (node.shown === entry && this.visible(panel)) return; // a press that changes nothing may be the first half of a double-click
    node.shown = entry;
    if (!this.isNarrow) { for (const side of this.sidesOf(panel)) this.hiddenSides.delete(side); if (this.largest && !this.largestGroup().includes(panel)) this.largest = ''; }
    this.save(); this.build();
  }

  sidesOf(panel, node = this.root) {
    if (node.tabs || !panelsOf(node).includes(panel)) return [];
    return [...(node.side ? [node.side] : []), ...node.of.flatMap((child) => this.sidesOf(panel, child))];
  }

  toggleSide(side) { this.hiddenSides.has(side) ? this.hiddenSides.delete(side) : this.hiddenSides.add(side); this.largest = ''; this.save(); this.build(); }

  // Lets the group with a panel fill the window; '' = none.
  enlarge(panel) { this.largest = this.largest === panel ? '' : panel; this.build(); }

  build() {
    const focused = document.activeElement?.id;
    this.showing = new Set();
    this.dock.classList.toggle('narrow', this.isNarrow);
    const top = this.make(this.root);
    for (const panel of Object.values(PANEL)) if (!top.contains(panel)) { panel.hidden = true; top.append(panel); }
    this.dock.replaceChildren(top);
    for (const side of ['left', 'bottom', 'right']) $(`side-${side}`).setAttribute('aria-pressed', !this.hiddenSides.has(side));
    if (focused && document.activeElement === document.body) $(focused)?.focus();
    this.onChange?.();
  }

  make(node) {
    if (node.tabs) return this.makeGroup(node);
    const box = element('div', '', { className: `split split-${node.split}` }), shown = node.of.map((child, k) => [child, k]).filter(([child]) => !this.hiddenSides.has(child.side));
    shown.forEach(([child, k], place) => {
      if (place) box.append(this.makeSplitter(node, shown[place - 1][1], k));
      const made = this.make(child);
      made.style.flex = `${node.at[k]} 1 0px`;
      box.append(made);
    });
    return box;
  }

  makeSplitter(node, before, after) {
    const bar = element('div', '', { className: 'splitter', tabIndex: 0 }), row = node.split === 'row';
    bar.setAttribute('role', 'separator'); bar.dataset.keys = '';
    bar.setAttribute('aria-orientation', row ? 'vertical' : 'horizontal');
    bar.setAttribute('aria-label', `border between ${title(panelsOf(node.of[before])[0])} and ${title(panelsOf(node.of[after])[0])}`);
    const total = () => node.at[before] + node.at[after];
    const set = (share) => {
      const sum = total();
      node.at[before] = Math.max(LEAST, Math.min(sum - LEAST, share)); node.at[after] = sum - node.at[before];
      bar.previousElementSibling.style.flexGrow = node.at[before]; bar.nextElementSibling.style.flexGrow = node.at[after];
      bar.setAttribute('aria-valuenow', Math.round(100 * node.at[before] / sum));
    };
    bar.setAttribute('aria-valuenow', Math.round(100 * node.at[before] / total()));
    bar.onpointerdown = (event) => { bar.setPointerCapture(event.pointerId); event.preventDefault(); bar.focus({ focusVisible: false }); };
    bar.onpointermove = (event) => {
      if (!bar.hasPointerCapture(event.pointerId)) return;
      const a = bar.previousElementSibling.getBoundingClientRect(), b = bar.nextElementSibling.getBoundingClientRect();
      set(total() * (row ? (event.clientX - a.left) / (b.right - a.left) : (event.clientY - a.top) / (b.bottom - a.top)));
    };
    bar.onpointerup = () => this.save();
    bar.onkeydown = (event) => {
      const sign = { ArrowLeft: -1, ArrowUp: -1, ArrowRight: 1, ArrowDown: 1 }[event.key];
      if (!sign) return;
      event.preventDefault(); set(node.at[before] + sign * STEP); this.save();
    };
    return bar;
  }

  makeGroup(node) {
    const box = element('div', '', { className: 'group' }), strip = element('div', '', { className: 'tabs' }), body = element('div', '', { className: 'body' });
    const list = element('div', '', { className: 'tablist' });
    list.setAttribute('role', 'tablist'); list.dataset.keys = '';
    const isLargest = this.largest && node.tabs.some((entry) => entry.split('+').includes(this.largest));
    box.classList.toggle('largest', Boolean(isLargest));
    for (const entry of node.tabs) {
      const parts = entry.split('+'), tab = element('button', title(entry), { id: `tab-${parts[0]}` }), isShown = entry === node.shown;
      tab.setAttribute('role', 'tab'); tab.setAttribute('aria-selected', isShown); tab.setAttribute('aria-controls', `panel-${parts[0]}`); tab.tabIndex = isShown ? 0 : -1;
      tab.onclick = () => { if (!tab.dataset.dragged) this.show(parts[0]); delete tab.dataset.dragged; };
      tab.ondblclick = () => { if (!this.isNarrow) this.enlarge(parts[0]); };
      if (!this.isNarrow) this.makeDraggable(tab, entry);
      list.append(tab);
      for (const part of parts) {
        const panel = PANEL[part];
        panel.hidden = !isShown;
        panel.setAttribute('role', parts.length > 1 ? 'region' : 'tabpanel');
        if (parts.length > 1) { panel.removeAttribute('aria-labelledby'); panel.setAttribute('aria-label', panel.dataset.title); } else { panel.removeAttribute('aria-label'); panel.setAttribute('aria-labelledby', `tab-${part}`); }
        body.append(panel);
        if (isShown) this.showing.add(part);
      }
    }
    body.classList.toggle('stacked', node.shown.includes('+'));
    list.onkeydown = (event) => {
      const move = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!move) return;
      event.preventDefault();
      const next = node.tabs[(node.tabs.indexOf(node.shown) + move + node.tabs.length) % node.tabs.length].split('+')[0];
      this.show(next); $(`tab-${next}`).focus();
    };
    strip.append(list);
    if (!this.isNarrow) {
      const large = element('button', isLargest ? '⤡' : '⤢', { className: 'large', title: isLargest ? 'back to its place (Esc)' : 'fill the window' });
      large.setAttribute('aria-label', `${large.title}: ${title(node.shown)}`);
      large.onclick = () => this.enlarge(isLargest ? this.largest : node.shown.split('+')[0]);
      strip.append(large);
    }
    box.append(strip, body);
    box.node = node;
    return box;
  }

  // Lets a tab be dragged to another group, or to an edge of one, which it then splits.
  makeDraggable(tab, entry) {
    let begin = null, target = null;
    const end = () => { begin = target = null; this.dock.querySelector('.drop')?.remove(); };
    tab.onpointerdown = (event) => { if (event.button === 0) { begin = [event.clientX, event.clientY]; tab.setPointerCapture(event.pointerId); } };
    tab.onpointermove = (event) => {
      if (!begin || (!tab.dataset.dragged && Math.hypot(event.clientX - begin[0], event.clientY - begin[1]) < DRAG)) return;
      tab.dataset.dragged = '1';
      const box = document.elementsFromPoint(event.clientX, event.clientY).map((e) => e.closest('.group')).find((e) => e && this.dock.contains(e));
      this.dock.querySelector('.drop')?.remove();
      target = null;
      if (!box) return;
      const r = box.getBoundingClientRect(), x = (event.clientX - r.left) / r.width, y = (event.clientY - r.top) / r.height;
      const near = Math.min(x, 1 - x, y, 1 - y), edge = near > EDGE || event.clientY - r.top < 30 ? '' : near === x ? 'left' : near === 1 - x ? 'right' : near === y ? 'top' : 'bottom';
      target = { node: box.node, edge };
      box.append(element('div', '', { className: `drop ${edge}` }));
    };
    tab.onpointerup = () => { const to = target; end(); if (to) this.move(entry, to.node, to.edge); };
    tab.onpointercancel = end;
  }

  // Moves a tab to a group: among its tabs (edge ''), or beside it.
  move(entry, node, edge) {
    const from = this.groupOf(entry);
    if (from === node && (!edge || node.tabs.length === 1)) { node.shown = entry; this.build(); return; }
    from.tabs = from.tabs.filter((e) => e !== entry);
    if (from.shown === entry) from.shown = from.tabs[0] ?? '';
    if (!edge) { node.tabs.push(entry); node.shown = entry; } else {
      const inner = { ...node }, added = group(entry), first = edge === 'left' || edge === 'top';
      for (const key of Object.keys(node)) delete node[key];
      Object.assign(node, { split: edge === 'left' || edge === 'right' ? 'row' : 'column', at: [0.5, 0.5], of: first ? [added, inner] : [inner, added] });
      if (inner.side) { node.side = inner.side; delete inner.side; }
    }
    this.desktop = this.pruned(this.desktop);
    this.save(); this.build();
  }

  // Returns a node without empty groups.
  pruned(node) {
    if (node.tabs) return node.tabs.length ? node : null;
    const kept = node.of.map((child, k) => [this.pruned(child), node.at[k]]).filter(([child]) => child), sum = kept.reduce((total, [, share]) => total + share, 0);
    if (!kept.length) return null;
    if (kept.length === 1) { const [only] = kept[0]; if (node.side && !only.side) only.side = node.side; return only; }
    return { ...node, of: kept.map(([child]) => child), at: kept.map(([, share]) => share / sum) };
  }
}
