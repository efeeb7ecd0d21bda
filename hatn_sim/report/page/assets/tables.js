// What stands beside and under the map: the ego, moments to jump to, scores, settings.

// Why an ego is told what it is told, or nothing.
const WHY = {
  likely_unsafe: 'the likelier slot is not safe', held: 'as told before', far: 'the conflict is far',
  unsure: 'no slot leads by enough', settling: 'the choice is still settling',
  unsafe_pass: 'the likely pass is not safe', too_late: 'a yield would be beyond comfort',
  gone_in_time: 'likely to be out before the other comes', in_the_way: 'in the other\u2019s way already',
  other_waits: 'the other is likelier to wait', stands: 'both stand',
  said_otherwise: 'the opposite was said before', mutual: 'the other is told to yield',
  brief: 'over before a driver could react', alerted: 'an alert tells the opposite',
};

// The side panel is made anew a few times a second.
function drawPanel(app, view) {
  const panel = document.getElementById('panel');
  const ego = app.head.vehicles[app.ego];
  if (!ego) {
    panel.replaceChildren(element('h2', { textContent: 'Ego' }),
      element('p', { class: 'soft', textContent: 'Click a vehicle, or choose one below the map.' }));
    return;
  }
  const lines = [
    element('h2', { textContent: shortened(ego.id, 60), title: ego.id }),
    element('p', { class: 'soft', textContent: view.ego ? `${ego.kind}, ${view.ego.speed.toFixed(1)} m/s` : `${ego.kind}, not in view now` }),
    ...adviceLines(app, view),
    ...slotLines(app, view),
    ...alertLines(app, view),
    ...modeLines(view),
  ];
  panel.replaceChildren(...lines);
}

function adviceLines(app, view) {
  const said = view.advice;
  if (!said) return [];
  const facts = [];
  if (said.speed_mps !== null) facts.push(`${said.speed_mps.toFixed(1)} m/s on the way`);
  if (said.target_s !== null) facts.push(`at the conflict in ${said.target_s.toFixed(1)} s`);
  if (!said.feasible) facts.push('beyond comfort');
  if (said.reason && said.reason !== 'likely') facts.push(WHY[said.reason] || said.reason.replaceAll('_', ' '));
  return [
    element('h3', { textContent: 'Advice' }),
    element('p', { class: `advice ${said.action}`, textContent: said.text }),
    element('p', { class: 'soft', textContent: facts.join(' \u00b7 ') }),
  ];
}

function slotLines(app, view) {
  const told = view.slots.filter((slot) => slot.chance !== null);
  if (!told.length) {
    const why = !view.ego ? '' : app.head.predictor === null ? 'Nothing was predicted in this run.'
      : 'No choice between slots now.';
    return why ? [element('h3', { textContent: 'Slots' }), element('p', { class: 'soft', textContent: why })] : [];
  }
  const rows = told.map((slot) => {
    const fill = element('span', { class: 'fill' });
    fill.style.width = `${100 * slot.chance}%`;
    fill.style.background = chanceColour(slot.chance);
    const words = slot.own ? 'yield' : `before ${shortened(nameOf(app, slot.vehicle), 24)}`;
    const where = slot.own ? '' : `${slot.merge ? 'merge' : 'crossing'} in ${slot.egoTo.toFixed(0)} m, it is ${slot.rearTo.toFixed(0)} m away`;
    const row = element('button', { type: 'button', class: 'slot', title: where }, [
      element('span', { class: 'name', textContent: words }),
      element('span', { class: 'bar' }, [fill]),
      element('span', { class: 'value', textContent: percent(slot.chance) }),
      element('span', { class: 'where', textContent: where }),
    ]);
    if (!slot.own) row.addEventListener('click', () => app.choose(slot.vehicle));
    return row;
  });
  return [element('h3', { textContent: 'Slots' }), ...rows];
}

function alertLines(app, view) {
  const own = view.alerts.filter((alert) => alert.ego === app.ego || alert.other === app.ego);
  if (!own.length) return [];
  return [
    element('h3', { textContent: 'Alert' }),
    ...own.map((alert) => element('p', { class: 'alarm', textContent: `${alert.text} \u2013 with ${shortened(nameOf(app, alert.ego === app.ego ? alert.other : alert.ego), 40)}` })),
  ];
}

function modeLines(view) {
  if (!view.ego || !view.ego.chunk.modeCount[view.ego.row]) return [];
  const flags = view.ego.chunk.flags[view.ego.row];
  const words = modesOf(view.ego).map(({ chance, points }) => {
    const end = points[points.length - 1];
    return `${percent(chance)}: ${Math.hypot(end[0] - points[0][0], end[1] - points[0][1]).toFixed(1)} m`;
  });
  const notes = [];
  if (flags & FLAG.fallback) notes.push('no line was found: it goes on as it goes');
  if (flags & FLAG.adapted) notes.push('adapted to this driver');
  return [
    element('h3', { textContent: 'In 3 s, as predicted' }),
    element('p', { textContent: words.join('  \u00b7  ') }),
    ...notes.map((note) => element('p', { class: 'soft', textContent: note })),
  ];
}

function makeMoments(app, jump) {
  const host = document.getElementById('moments');
  if (!app.moments.length) {
    host.replaceChildren(element('h2', { textContent: 'Alerts and events' }),
      element('p', { class: 'soft', textContent: 'None in this run.' }));
    return;
  }
  const rows = app.moments.map((moment) => {
    const names = [moment.ego, moment.other].filter((one) => one >= 0).map((one) => nameOf(app, one));
    const button = element('button', { type: 'button', textContent: `${moment.from.toFixed(1)} s` });
    button.addEventListener('click', () => jump(moment.from, moment.ego));
    return element('tr', {}, [
      element('td', {}, [button]),
      element('td', { class: moment.row, textContent: moment.row === 'alerts' ? 'alert' : moment.kind }),
      element('td', { textContent: names.join(' \u2013 ') }),
      element('td', { textContent: `${moment.words}${moment.more ? ` (${moment.more})` : ''}` }),
    ]);
  });
  const head = element('tr', {}, ['when', 'what', 'who', ''].map((text) => element('th', { textContent: text })));
  host.replaceChildren(element('h2', { textContent: 'Alerts and events' }),
    element('div', { class: 'wide tall', tabIndex: 0 }, [element('table', { class: 'moments' }, [
      element('thead', {}, [head]), element('tbody', {}, rows)])]));
}

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
  host.replaceChildren(element('h2', { textContent: 'Scores' }), ...made,
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

function makeLegend() {
  const host = document.getElementById('legend');
  const item = (mark, words) => element('span', { class: 'item' }, [element('i', { class: mark }), words]);
  host.replaceChildren(
    element('span', { class: 'item' }, ['slot', '\u2002', '0', element('i', { class: 'scale' }), '100 %']),
    item('predicted', 'predicted, 3 s'), item('happened', 'what happened'),
    item('conflict', 'conflict'), item('alarm', 'alert'));
}
