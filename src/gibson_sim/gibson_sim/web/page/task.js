// A task: starting it, its text, its result.
import { $, element } from './dom.js';
import { words } from './tree.js';

export class Task {
  constructor(send) {
    $('task-start').onclick = () => send('task', { action: 'start', task: $('task-name').value, baseline: $('task-baseline').value, seed: Number($('task-seed').value) || 0 });
    $('task-next').onclick = () => send('task', { action: 'next' });
    $('task-stop').onclick = () => send('task', { action: 'stop' });
  }

  set(t) {
    const info = t.info, result = t.result, ended = 'success' in result;
    $('task-form').hidden = t.running || t.there;
    $('task-next').hidden = !t.there; $('task-stop').hidden = !t.running;
    $('task-text').textContent = info.task ? `${info.task}, seed ${info.seed}: ${info.text || ''}` : t.running ? 'Setting up …' : '';
    $('task-result').textContent = ended ? `${result.success ? 'Succeeded' : 'Failed'} after ${Number(result.time ?? 0).toFixed(1)} s` : t.there ? `Running; time limit ${Number(info.time_limit ?? 0).toFixed(0)} s` : '';
    $('task-result').className = ended ? (result.success ? 'good' : 'bad') : '';
    const rows = ended ? Object.entries(result).filter(([k, v]) => typeof v === 'number' && !['seed', 'time'].includes(k)) : [];
    $('task-score').replaceChildren(...rows.map(([k, v]) => { const li = element('li'); li.append(element('span', words(k)), element('b', String(Number(v.toFixed(2))))); return li; }));
    $('task-error').textContent = t.error;
  }
}
