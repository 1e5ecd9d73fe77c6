// The state of the nodes, from /diagnostics, and a log of its changes and of the page's notes.
import { $, element, keyed, nameElement, onNote } from './dom.js';

const LEVELS = ['ok', 'warning', 'error', 'stale'];
const KEPT = 300; // lines of the log
const ENOUGH = 0.9; // share of the due images; with more than that, nobody needs advice
const LASTS = 3; // reports after which a warning is more than a moment

export class Log {
  // onBusy([drawn, due] | null): images per second, if render nodes skip some of them.
  constructor(onBusy) {
    this.onBusy = onBusy; this.known = new Map(); this.lines = []; this.time = null; this.skipping = 0;
    $('log-level').onchange = () => this.draw();
    $('log-clear').onclick = () => { this.lines = []; this.draw(); };
    onNote((text, bad) => this.add(bad ? 2 : 0, 'page', text));
  }

  // Shows the newest reports. A render node that skips images is busy, not wrong, and a warning counts if it lasts.
  set(diagnostics, time) {
    this.time = time;
    const shown = diagnostics.map((d) => {
      const values = Object.fromEntries(d.values), skipped = Number(values.skipped), drawn = Number(values.images_per_s), due = Number(values.due_per_s), isBusy = d.level === 1 && skipped > 0 && due > 0;
      const before = this.known.get(d.name), count = before && before.raw === d.level ? before.count + 1 : 1;
      const level = isBusy ? 0 : d.level === 1 && count < LASTS ? (before?.level === 1 ? 1 : 0) : d.level;
      return { ...d, raw: d.level, count, level, message: isBusy ? `${Math.round(drawn)} of ${Math.round(due)} images/s` : d.message, isBusy, drawn, due };
    });
    for (const d of shown) {
      const before = this.known.get(d.name);
      if (!before || before.level !== d.level || (d.level && before.message !== d.message)) this.add(d.level, d.name.replace(/^gibson_sim: /, ''), d.message);
      this.known.set(d.name, d);
    }
    const busy = shown.filter((d) => d.isBusy && d.drawn < ENOUGH * d.due);
    this.skipping = busy.length ? Math.min(2 * LASTS, this.skipping + 1) : Math.max(0, this.skipping - 1);
    if (busy.length && this.skipping >= LASTS) this.onBusy([busy.reduce((sum, d) => sum + d.drawn, 0), busy.reduce((sum, d) => sum + d.due, 0)]);
    else if (!this.skipping) this.onBusy(null);
    const worst = Math.max(0, ...shown.map((d) => (d.level < 3 ? d.level : 0)));
    if ($('tab-log')) { $('tab-log').className = worst ? `level${worst}` : ''; $('tab-log').title = LEVELS[worst]; }
    $('diagnostics-empty').hidden = shown.length > 0;
    keyed($('diagnostics'), shown, (d) => d.name, (d) => { const li = element('li'); li.append(nameElement(d.name.replace(/^gibson_sim: /, '')), element('small')); return li; }, (li, d) => {
      li.className = `level${d.level}`;
      li.children[1].textContent = d.message;
      li.title = [LEVELS[d.level] ?? '', ...d.values.map(([k, v]) => `${k}: ${v}`)].join('\n');
    });
  }

  add(level, from, text) {
    this.lines.push({ level, from, text, time: this.time });
    if (this.lines.length > KEPT) this.lines.shift();
    this.draw();
  }

  draw() {
    const least = Number($('log-level').value), list = $('log'), atEnd = list.scrollTop + list.clientHeight > list.scrollHeight - 20;
    list.replaceChildren(...this.lines.filter((line) => line.level >= least).map((line) => {
      const li = element('li', '', { className: `level${line.level}` });
      li.append(element('small', line.time === null ? '–' : `${line.time.toFixed(2)} s`), element('b', line.from), element('span', line.text));
      return li;
    }));
    if (atEnd) list.scrollTop = list.scrollHeight;
  }
}
