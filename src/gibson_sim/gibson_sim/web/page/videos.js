// Images: live video of the selected topics, and snapshots of one or all of them.
import { $, download, element, fileName, note, remember, remembered } from './dom.js';
import { zip } from './zip.js';

const PATIENCE_MS = 5000; // timeout for snapshots of all cameras
const MAX_VIDEOS = 16; // largest number of videos that the server allows

export class Videos {
  constructor(onWatch) {
    this.onWatch = onWatch; this.topics = []; this.problems = {}; this.shown = new Map(); this.watched = new Set(remembered('watched', []));
    this.images = 0; this.state = ''; this.wanted = new Map();
    $('pictures').onclick = () => this.takeAll();
  }

  // Topics to be sent: shown videos and awaited snapshots.
  get needed() { return [...new Set([...this.shown.keys(), ...this.wanted.keys()])].slice(0, MAX_VIDEOS); }

  setTopics(topics) { this.topics = topics; this.update(); }

  update() {
    const available = new Set(this.topics.map((t) => t.topic));
    if (![...this.watched].some((t) => available.has(t)) && this.topics.length) this.watched.add(this.topics[0].topic);
    $('topics').replaceChildren(...this.topics.map((t) => {
      const button = element('button', t.label, { title: t.topic });
      button.setAttribute('aria-pressed', this.watched.has(t.topic));
      button.onclick = () => { this.watched.has(t.topic) ? this.watched.delete(t.topic) : this.watched.add(t.topic); this.update(); };
      return button;
    }));
    $('pictures').hidden = !this.topics.length;
    for (const [topic, video] of this.shown) if (!this.watched.has(topic) || !available.has(topic)) { video.figure.remove(); this.shown.delete(topic); }
    for (const t of this.topics) if (this.watched.has(t.topic) && !this.shown.has(t.topic)) this.shown.set(t.topic, this.make(t));
    const columns = this.shown.size > 2 ? 2 : 1;
    $('videos').style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
    $('videos').style.setProperty('--rows', Math.max(1, Math.ceil(this.shown.size / columns)));
    $('videos').querySelectorAll('.empty').forEach((e) => e.remove());
    if (!this.shown.size) $('videos').append(element('p', this.topics.length ? 'Choose a camera above.' : 'No camera publishes images.', { className: 'empty' }));
    remember('watched', [...this.watched]);
    this.explain();
    this.onWatch();
  }

  make(t) {
    const figure = element('figure'), canvas = element('canvas'), caption = element('figcaption', t.label), why = element('p', '', { className: 'why' });
    const save = element('button', 'save', { title: 'save this image as a PNG file' });
    save.onclick = () => canvas.toBlob((blob) => blob && download(blob, `${fileName(t.label)}.png`));
    canvas.dataset.topic = t.topic;
    caption.append(save);
    figure.append(canvas, why, caption);
    $('videos').append(figure);
    return { figure, canvas, why, save, context: canvas.getContext('2d') };
  }

  // Explains why a video has no image.
  explain() {
    for (const [topic, video] of this.shown) {
      const waiting = this.state === 'paused' ? 'Time is paused, and no image has arrived yet: press Step.' : 'Waiting for the first image.';
      const text = this.problems[topic] || (video.canvas.dataset.stamp ? '' : waiting);
      video.why.textContent = text;
      video.why.hidden = !text;
      video.save.hidden = !video.canvas.dataset.stamp;
    }
  }

  setState(state) { if (state !== this.state) { this.state = state; this.explain(); } }

  setProblems(problems) { this.problems = problems; this.explain(); }

  // Shows a received image, a JPEG file.
  async show(topic, stamp, data) {
    this.wanted.get(topic)?.(data);
    const video = this.shown.get(topic);
    if (!video) return;
    const bitmap = await createImageBitmap(new Blob([data], { type: 'image/jpeg' }));
    const first = !video.canvas.dataset.stamp;
    if (video.canvas.width !== bitmap.width || video.canvas.height !== bitmap.height) { video.canvas.width = bitmap.width; video.canvas.height = bitmap.height; video.figure.style.setProperty('--aspect', bitmap.width / bitmap.height); }
    video.context.drawImage(bitmap, 0, 0);
    video.canvas.dataset.stamp = stamp;
    bitmap.close();
    this.images++;
    if (first) this.explain();
  }

  // Takes a snapshot with every camera and downloads them as one ZIP file.
  async takeAll() {
    const topics = this.topics.slice(0, MAX_VIDEOS);
    $('pictures').disabled = true;
    const taken = topics.map((t) => new Promise((done) => {
      this.wanted.set(t.topic, (data) => { this.wanted.delete(t.topic); done([`${fileName(t.label)}.jpg`, new Uint8Array(data)]); });
      setTimeout(() => done(null), PATIENCE_MS);
    }));
    this.onWatch();
    const files = (await Promise.all(taken)).filter(Boolean);
    this.wanted.clear();
    this.onWatch();
    $('pictures').disabled = false;
    const missing = topics.length - files.length;
    if (files.length) download(zip(files), `pictures_${new Date().toISOString().slice(0, 19).replace(/[T:]/g, '-')}.zip`);
    if (missing) note(`${missing} of ${topics.length} cameras sent no image within 5 s${this.state === 'paused' ? ': time is paused' : ''}`, true);
    else note(`${files.length} images saved`);
  }
}
