// Scores, settings, and what the colours of the map mean.

function makeScores(app) {
  const host = document.getElementById('scores');
  const { tables, notes } = app.head.scores;
  if (!tables.length && !notes.length) { host.hidden = true; return; }
  const made = tables.map(({ title, columns, rows }) => element('div', { class: 'wide' }, [
    element('table', {}, [
      element('caption', { textContent: title }),
      element('thead', {}, [element('tr', {}, columns.map((text) => element('th', { textContent: text })))]),
      element('tbody', {}, rows.map((row) => element('tr', {}, row.map((cell) => {
        const [value, ...under] = cell.split('\n');
        return element('td', {}, [value, ...under.map((text) => element('small', { textContent: text }))]);
      })))),
    ])]));
  host.replaceChildren(element('h2', { textContent: 'Scores' }), element('div', { class: 'tables' }, made),
    element('p', { class: 'soft', textContent: '\u00b1 deviation of samples; [low high] 95 % interval' }),
    ...notes.map((note) => element('p', { class: 'soft', textContent: note })));
}

function makeSettings(app) {
  const host = document.getElementById('made');
  const copy = element('button', { type: 'button', textContent: 'Copy' });
  copy.addEventListener('click', () => copied(app.head.command, copy));
  const rows = app.head.settings.map(([name, value]) => element('tr', {}, [
    element('th', { textContent: name }), element('td', { textContent: value })]));
  const details = element('details', {}, [
    element('summary', { textContent: 'Settings and versions' }),
    element('div', { class: 'wide' }, [element('table', { class: 'settings' }, [element('tbody', {}, rows)])])]);
  const children = [element('h2', { textContent: 'How this run was made' })];
  if (app.head.command) {
    children.push(element('div', { class: 'command' }, [element('code', { textContent: app.head.command }), copy]));
  }
  host.replaceChildren(...children, details);
}

// Pages opened from disk may lack the clipboard: then the text is selected by hand.
async function copied(text, button) {
  const before = button.textContent;
  try {
    await navigator.clipboard.writeText(text);
    button.textContent = 'Copied';
  } catch {
    const field = element('textarea', { value: text, class: 'aside' });
    document.body.append(field);
    field.select();
    button.textContent = document.execCommand('copy') ? 'Copied' : 'Not copied';
    field.remove();
  }
  setTimeout(() => { button.textContent = before; }, 1500);
}

function makeLegend(app) {
  const host = document.getElementById('legend');
  const item = (mark, words) => element('span', { class: 'item' }, [element('i', { class: mark }), words]);
  const items = [item('ego', 'ego')];
  if (app.head.predictor !== null) {
    items.push(element('span', { class: 'item' }, ['slot, 0', element('i', { class: 'scale' }), '100 %']),
      item('predicted', 'predicted, 3 s'));
  }
  items.push(item('happened', 'what happened'), item('conflict', 'conflict'));
  if (app.head.alerts.length) items.push(item('alarm', 'alert'));
  if (app.head.signals_known && app.paths.stops.some(({ signals }) => signals.length)) {
    items.push(item('lamp closed', 'signal closed'), item('lamp open', 'open'));
  }
  host.replaceChildren(...items);
}
