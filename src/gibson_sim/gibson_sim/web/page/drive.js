// Driving with keys, joystick and gamepad. The command is repeated every 100 ms while nonzero; the server stops the robot when the repeats end.

const KEYS = {
  KeyW: ['x', 1], ArrowUp: ['x', 1], KeyS: ['x', -1], ArrowDown: ['x', -1],
  KeyA: ['turn', 1], ArrowLeft: ['turn', 1], KeyD: ['turn', -1], ArrowRight: ['turn', -1], KeyQ: ['y', 1], KeyE: ['y', -1],
};
const TURN = 1.2; // rad/s
const DEAD_ZONE = 0.15; // of a gamepad's stick

export class Driving {
  constructor(send, stick, onChange) {
    this.send = send; this.onChange = onChange; this.speed = 0.4;
    this.keys = new Set(); this.stick = { x: 0, turn: 0 }; this.moving = false;
    addEventListener('keydown', (event) => {
      const typing = event.target.closest && event.target.closest('input[type=text], input[type=search], input[type=number], textarea');
      if (!(event.code in KEYS) || event.ctrlKey || event.metaKey || event.altKey || typing) return;
      if (document.querySelector('dialog[open]')) return;
      if (event.target.closest?.('select, input[type=range], [data-keys]')) { // arrows change the control; letters drive
        if (event.code.startsWith('Arrow')) return;
        if (event.target.closest('select')) event.target.blur();
      }
      event.preventDefault(); this.keys.add(event.code); if (!event.repeat) this.tick();
    });
    addEventListener('keyup', (event) => { if (this.keys.delete(event.code)) this.tick(); });
    addEventListener('blur', () => this.release());
    const knob = stick.querySelector('i');
    const set = (x, y) => {
      const size = Math.hypot(x, y), scale = size > 1 ? 1 / size : 1;
      this.stick = { x: -y * scale, turn: -x * scale };
      knob.style.transform = `translate(${x * scale * 31}px, ${y * scale * 31}px)`;
    };
    const moved = (event) => {
      const box = stick.getBoundingClientRect();
      set(((event.clientX - box.left) / box.width) * 2 - 1, ((event.clientY - box.top) / box.height) * 2 - 1);
    };
    stick.onpointerdown = (event) => { stick.setPointerCapture(event.pointerId); moved(event); this.tick(); };
    stick.onpointermove = (event) => { if (stick.hasPointerCapture(event.pointerId)) moved(event); };
    stick.onpointerup = stick.onpointercancel = () => { set(0, 0); this.tick(); };
    this.center = () => set(0, 0);
    setInterval(() => this.tick(), 100);
  }

  command() {
    const sum = { x: this.stick.x, y: 0, turn: this.stick.turn };
    for (const code of this.keys) sum[KEYS[code][0]] += KEYS[code][1];
    const pad = [...(navigator.getGamepads?.() || [])].find((p) => p && p.connected);
    if (pad) {
      const axis = (k) => (Math.abs(pad.axes[k] || 0) > DEAD_ZONE ? pad.axes[k] : 0);
      sum.x -= axis(1); sum.turn -= axis(2) || axis(0);
    }
    const limit = (v) => Math.max(-1, Math.min(1, v));
    return { linear: limit(sum.x) * this.speed, lateral: limit(sum.y) * this.speed, angular: limit(sum.turn) * TURN };
  }

  tick() {
    const command = this.command(), moving = Boolean(command.linear || command.lateral || command.angular);
    if (moving || this.moving) this.send('drive', command);
    if (moving !== this.moving) this.onChange(moving);
    this.moving = moving;
  }

  release() { this.keys.clear(); this.center(); this.tick(); }
}
