// Images: live video of the selected topics, one of them large or all in a grid; stills of the others; snapshots of all of them.
import { $, download, element, fileName, note, remember, remembered } from './dom.js';
import { zip } from './zip.js';

const PATIENCE_MS = 5000; // timeout for a snapshot
const MAX_VIDEOS = 16; // largest number of videos that the server allows
const STILL_MS = 1500, RENEWED = 3; // interval between two first stills, each of another camera; every RENEWED-th interval, one is renewed
const SEEN_MS = 200; // after the first image was drawn: what the page does next could delay the frame with it
const STRIP = 84, SIDE = 132, GAP = 6; // height of the strip below the large image, its width beside it, and the gap, pixels

export class Videos {
  constructor(onWatch) {
    this.onWatch = onWatch; this.topics = []; this.problems = {}; this.figures = new Map(); this.state = ''; this.wanted = new Map(); this.visible = true;
    this.watched = new Set(remembered('watched', [])); this.main = remembered('main', ''); this.isGrid = remembered('grid', false);
    this.images = 0; this.seen = false; this.busy = false; this.still = 0;
    $('pictures').onclick = () => this.takeAll();
    $('grid').onclick = () => { this.isGrid = !this.isGrid; remember('grid', this.isGrid); this.update(); };
    new ResizeObserver(() => this.arrange()).observe($('videos'));
    setInterval(() => this.takeStill(), STILL_MS);
  }

  // Live topics: those selected, or all in a grid.
  get live() { return this.isGrid ? this.topics.slice(0, MAX_VIDEOS).map((t) => t.topic) : this.topics.filter((t) => this.watched.has(t.topic)).map((t) => t.topic); }

  // Topics to be sent: live videos and awaited snapshots.
  get needed() { return [...new Set([...(this.visible ? this.live : []), ...this.wanted.keys()])].slice(0, MAX_VIDEOS); }

  setTopics(topics) { this.topics = topics; this.update(); }

  // Shows one camera alone.
  showOne() { this.isGrid = false; this.watched = new Set([this.main]); remember('grid', false); this.update(); }

  toggle(topic) {
    if (this.watched.has(topic)) { this.watched.delete(topic); if (this.main === topic) this.main = this.live[0] || ''; } else { this.watched.add(topic); this.main = topic; }
    this.update();
  }

  // Makes a camera the large one; one that was a still takes the place of the large one.
  enlarge(topic) {
    if (!this.watched.has(topic)) { this.watched.delete(this.main); this.watched.add(topic); }
    this.main = topic;
    this.isGrid = false;
    this.update();
  }

  update() {
    const available = new Set(this.topics.map((t) => t.topic));
    if (![...this.watched].some((t) => available.has(t)) && this.topics.length && !this.touched) this.watched.add(this.topics[0].topic);
    this.touched ||= this.topics.length > 0;
    if (!available.has(this.main) || !this.watched.has(this.main)) this.main = this.live[0] || '';
    const live = new Set(this.live);
    $('topics').replaceChildren(...this.topics.map((t) => {
      const button = element('button', t.label, { title: live.has(t.topic) ? `${t.topic}: live` : t.topic });
      button.setAttribute('aria-pressed', live.has(t.topic));
      button.disabled = this.isGrid;
      button.onclick = () => this.toggle(t.topic);
      return button;
    }));
    $('grid').setAttribute('aria-pressed', this.isGrid); $('grid').hidden = this.topics.length < 2;
    $('pictures').hidden = !this.topics.length;
    for (const [topic, figure] of this.figures) if (!available.has(topic)) { figure.box.remove(); this.figures.delete(topic); }
    for (const t of this.topics) if (!this.figures.has(t.topic)) this.figures.set(t.topic, this.make(t));
    for (const [topic, figure] of this.figures) figure.box.classList.toggle('live', live.has(topic));
    remember('watched', [...this.watched]); remember('main', this.main);
    this.arrange();
    this.explain();
    this.onWatch();
  }

  make(t) {
    const box = element('figure'), canvas = element('canvas'), caption = element('figcaption'), why = element('p', '', { className: 'why' });
    const large = element('button', t.label, { className: 'name', title: `${t.topic}: show it large` }), save = element('button', 'save', { title: 'save this image as a PNG file' });
    canvas.dataset.topic = t.topic;
    canvas.setAttribute('role', 'img'); canvas.setAttribute('aria-label', `image of ${t.label}`);
    large.onclick = () => this.enlarge(t.topic);
    save.setAttribute('aria-label', `save the image of ${t.label}`);
    save.onclick = () => canvas.toBlob((blob) => blob && download(blob, `${fileName(t.label)}.png`));
    caption.append(large, save);
    box.append(canvas, why, caption);
    box.onclick = (event) => { if (event.target === canvas && box.parentElement === $('strip')) this.enlarge(t.topic); };
    return { box, canvas, why, save, context: canvas.getContext('2d'), aspect: 4 / 3 };
  }

  // Puts the figures into the stage and the strip, so that the images are as large as fits.
  arrange() {
    const stage = $('stage'), strip = $('strip'), w = $('videos').clientWidth, h = $('videos').clientHeight, order = this.topics.map((t) => t.topic);
    const main = this.figures.get(this.main), inStage = this.isGrid ? order : main ? [this.main] : [], inStrip = order.filter((t) => !inStage.includes(t) && (!this.isGrid));
    place(stage, inStage.map((t) => this.figures.get(t).box));
    place(strip, inStrip.map((t) => this.figures.get(t).box));
    stage.querySelectorAll('.empty').forEach((e) => e.remove());
    if (!inStage.length) stage.append(element('p', order.length ? 'Choose a camera above.' : 'No camera publishes images.', { className: 'empty' }));
    strip.hidden = !inStrip.length || h < 200;
    const aspect = main?.aspect ?? 4 / 3, below = Math.min(w, (h - STRIP - GAP) * aspect), beside = Math.min(w - SIDE - GAP, h * aspect);
    $('videos').classList.toggle('beside', !strip.hidden && beside > below);
    let columns = 1;
    const height = (n) => Math.min(w / n / aspect, h / Math.ceil(inStage.length / n));
    for (let n = 2; n <= inStage.length; n++) if (height(n) > height(columns) + 1) columns = n;
    stage.style.setProperty('--columns', columns);
    stage.style.setProperty('--rows', Math.max(1, Math.ceil(inStage.length / columns)));
  }

  // Explains why a video has no image.
  explain() {
    const live = new Set(this.live);
    for (const [topic, figure] of this.figures) {
      const waiting = this.state === 'paused' ? 'Time is paused, and no image has arrived yet: press Step.' : 'Waiting for the first image.';
      const text = this.problems[topic] || (figure.canvas.dataset.stamp ? '' : live.has(topic) ? waiting : 'not live');
      figure.why.textContent = text;
      figure.why.hidden = !text;
      figure.save.hidden = !figure.canvas.dataset.stamp;
    }
  }

  setState(state) { if (state !== this.state) { this.state = state; this.explain(); } }

  setProblems(problems) { this.problems = problems; this.explain(); }

  // Shows a received image, a JPEG file.
  async show(topic, stamp, data) {
    this.wanted.get(topic)?.(data);
    const figure = this.figures.get(topic);
    if (!figure) return;
    const bitmap = await createImageBitmap(new Blob([data], { type: 'image/jpeg' })), canvas = figure.canvas, first = !canvas.dataset.stamp;
    if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
      canvas.width = bitmap.width; canvas.height = bitmap.height; figure.aspect = bitmap.width / bitmap.height;
      figure.box.style.setProperty('--aspect', figure.aspect);
      this.arrange();
    }
    figure.context.drawImage(bitmap, 0, 0);
    canvas.dataset.stamp = stamp;
    bitmap.close();
    if (this.live.includes(topic)) this.images++;
    if (first) this.explain();
    if (!this.seen) requestAnimationFrame(() => setTimeout(() => { this.seen = true; this.onWatch(); }, SEEN_MS));
  }

  // Receives one image of a camera, or null.
  one(topic) {
    return new Promise((done) => {
      const timer = setTimeout(() => { this.wanted.delete(topic); done(null); }, PATIENCE_MS);
      this.wanted.set(topic, (data) => { clearTimeout(timer); this.wanted.delete(topic); done(data); });
    });
  }

  // Renews the still of one of the cameras that are not live, in turn; not while the machine is busy, once all have one.
  async takeStill() {
    if (document.hidden || !this.visible || !this.seen || this.isGrid || this.wanted.size || $('strip').hidden) return;
    const live = new Set(this.live), stills = this.topics.map((t) => t.topic).filter((t) => !live.has(t)), empty = stills.find((t) => !this.figures.get(t).canvas.dataset.stamp);
    if (!empty && (this.busy || ++this.still % RENEWED)) return;
    const topic = empty ?? stills[(this.still / RENEWED) % Math.max(1, stills.length)];
    if (!topic) return;
    const arrived = this.one(topic);
    this.onWatch();
    await arrived;
    this.onWatch();
  }

  // Takes a snapshot with every camera and downloads them as one ZIP file.
  async takeAll() {
    const topics = this.topics.slice(0, MAX_VIDEOS);
    $('pictures').disabled = true;
    const taken = topics.map((t) => this.one(t.topic).then((data) => data && [`${fileName(t.label)}.jpg`, new Uint8Array(data)]));
    this.onWatch();
    const files = (await Promise.all(taken)).filter(Boolean);
    this.onWatch();
    $('pictures').disabled = false;
    const missing = topics.length - files.length;
    if (files.length) download(zip(files), `pictures_${new Date().toISOString().slice(0, 19).replace(/[T:]/g, '-')}.zip`);
    if (missing) note(`${missing} of ${topics.length} cameras sent no image within 5 s${this.state === 'paused' ? ': time is paused' : ''}`, true);
    else note(`${files.length} images saved`);
  }
}

function place(parent, children) {
  const old = [...parent.children].filter((c) => c.tagName === 'FIGURE');
  if (old.length !== children.length || old.some((c, k) => c !== children[k])) parent.replaceChildren(...children);
}
