// The table of alerts and events: each leads to its moment; kinds are switched on and off.

const KINDS = {
  alert: { glyph: '\u25ac', words: 'alert' }, T1: { glyph: '\u2715', words: 'T1 collision' },
  T2: { glyph: '\u25b2', words: 'T2 evasive braking' }, T3: { glyph: '\u25cb', words: 'T3 close pass' },
};

function makeMoments(app, jump) {
  const host = document.getElementById('moments');
  const title = element('h2', { textContent: 'Alerts and events' });
  if (!app.moments.length) {
    host.replaceChildren(title, element('p', { class: 'soft', textContent: 'None in this run: nobody was warned, and nobody collided, braked to evade or passed closely.' }));
    return () => {};
  }
  const hidden = new Set();
  let onlyEgo = false, marked = null;
  const rows = app.moments.map((moment) => ({ moment, row: momentRow(app, moment, jump) }));
  const nothing = element('p', { class: 'soft', textContent: 'None of these.' });
  const sift = () => {
    let shown = 0;
    for (const { moment, row } of rows) {
      const own = moment.ego === app.ego || moment.other === app.ego;
      row.hidden = hidden.has(moment.kind) || (onlyEgo && !own);
      shown += !row.hidden;
    }
    nothing.hidden = shown > 0;
  };
  const toggle = (words, pressed, change) => {
    const button = element('button', { type: 'button', textContent: words, 'aria-pressed': String(pressed) });
    button.addEventListener('click', () => {
      const now = button.getAttribute('aria-pressed') !== 'true';
      button.setAttribute('aria-pressed', String(now));
      change(now);
      sift();
    });
    return button;
  };
  const kinds = Object.keys(KINDS).map((kind) => [kind, rows.filter(({ moment }) => moment.kind === kind).length]);
  const switches = kinds.filter(([, count]) => count).map(([kind, count]) =>
    toggle(`${KINDS[kind].words} ${count}`, true, (on) => (on ? hidden.delete(kind) : hidden.add(kind))));
  switches.push(toggle('only of the ego', false, (on) => { onlyEgo = on; }));
  const head = element('tr', {}, ['when', 'what', 'who', 'in words'].map((text) => element('th', { textContent: text })));
  host.replaceChildren(element('div', { class: 'titled' }, [title, element('div', { class: 'switches' }, switches)]),
    element('div', { class: 'wide tall', tabIndex: 0 }, [element('table', { class: 'moments' }, [
      element('thead', {}, [head]), element('tbody', {}, rows.map(({ row }) => row))])]), nothing);
  sift();
  let siftedFor = app.ego;
  // Marks the moment that was last come to, and follows the choice of an ego.
  return (view) => {
    if (siftedFor !== app.ego && onlyEgo) sift();
    siftedFor = app.ego;
    const last = rows.findLast(({ moment }) => moment.from <= view.time + 1e-6)?.row ?? null;
    if (last === marked) return;
    marked?.classList.remove('now');
    last?.classList.add('now');
    marked = last;
  };
}

function momentRow(app, moment, jump) {
  const names = [moment.ego, moment.other].filter((one) => one >= 0).map((one) => nameOf(app, one));
  const button = element('button', { type: 'button', textContent: `${moment.from.toFixed(1)} s` });
  button.addEventListener('click', () => jump(moment.from, moment.ego, moment));
  const { glyph, words } = KINDS[moment.kind];
  return element('tr', {}, [
    element('td', {}, [button]),
    element('td', { class: `kind ${moment.kind}` }, [element('span', { textContent: glyph }), ` ${words}`]),
    element('td', { class: 'who', title: names.join(' \u2013 '), textContent: names.map((name) => shortened(name, 28)).join(' \u2013 ') }),
    element('td', { textContent: moment.row === 'alerts' ? `${moment.words} (${moment.more})` : moment.more }),
  ]);
}
