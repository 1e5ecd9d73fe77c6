// Recordings: making one, and the list of those on the server; their plots and the reports of trials open in a frame that runs no scripts.
import { $, element, keyed, nameElement } from './dom.js';

const size = (bytes) => (bytes < 1e6 ? `${Math.round(bytes / 1e3)} kB` : bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(2)} GB`);
const clock = (s) => `${Math.floor(s / 60)}:${String(s % 60).padStart(2, '0')}`;
const date = (s) => new Date(1000 * s).toLocaleString([], { dateStyle: 'medium', timeStyle: 'short' });

export class Recordings {
  constructor(send) {
    this.state = { on: false }; this.opened = '';
    $('record').onclick = () => send('record', this.state.on ? { action: 'stop' } : { action: 'start', images: $('record-images').checked });
    $('recordings-refresh').onclick = () => this.refresh();
    $('viewer-close').onclick = () => $('viewer').close();
    $('viewer').onclose = () => { this.opened = ''; $('viewer-frame').removeAttribute('src'); };
  }

  set(r) {
    const ended = this.state.on && !r.on;
    this.state = r;
    $('record').textContent = r.on ? 'Stop' : 'Record';
    $('record').classList.toggle('on', r.on);
    $('record-images').disabled = r.on;
    $('record-what').textContent = r.on && r.seconds === null ? 'Starting: nothing is recorded yet …' : r.on || r.bytes ? `${r.folder}: ${size(r.bytes)}${r.seconds === null ? '' : `, ${clock(r.seconds)}`}` : r.error ? '' : 'A rosbag2 folder on the server.';
    $('record-error').textContent = r.error;
    $('recording').hidden = !r.on;
    $('recording').textContent = r.seconds === null ? 'REC' : `REC ${clock(r.seconds ?? 0)}`;
    if (ended) this.refresh();
  }

  // Lists the recordings of the server anew.
  async refresh() {
    const answer = await fetch('/recordings').catch(() => null), list = answer?.ok ? await answer.json() : null;
    $('recordings-empty').textContent = !list ? 'The server lists no recordings.' : list.entries.length ? `In ${list.folder}:` : `No recording and no trial below ${list.folder}.`;
    keyed($('recordings'), list?.entries ?? [], (r) => r.key, (r) => {
      const li = element('li'), button = element('button', r.kind === 'bag' ? 'Plots' : 'Report');
      button.setAttribute('aria-label', `${button.textContent} of ${r.name}`);
      button.onclick = () => this.open(r);
      li.append(nameElement(r.name), element('small'), button);
      return li;
    }, (li, r) => { li.children[1].textContent = [r.text, r.seconds === null ? '' : `${r.seconds.toFixed(1)} s`, size(r.bytes), date(r.modified)].filter(Boolean).join(' · '); });
  }

  // Opens the plots of a bag, or the report of a trial.
  async open(r) {
    const address = `/recordings/${r.key}/${r.kind === 'bag' ? 'plots' : 'report'}`;
    this.opened = r.key;
    $('viewer-title').textContent = r.name;
    $('viewer-note').textContent = r.kind === 'bag' ? 'The bag is read and plotted; a long one takes a minute …' : 'Loading …';
    $('viewer-frame').hidden = true;
    $('viewer').showModal();
    const answer = await fetch(address).catch(() => null), text = answer?.ok ? '' : answer ? await answer.text() : 'the server does not answer';
    answer?.body?.cancel().catch(() => {}); // the frame asks again; the server keeps the plots
    if (this.opened !== r.key) return;
    $('viewer-note').textContent = text;
    if (text) return;
    $('viewer-frame').src = address;
    $('viewer-frame').title = r.kind === 'bag' ? `plots of ${r.name}` : `report of ${r.name}`;
    $('viewer-frame').hidden = false;
  }
}
