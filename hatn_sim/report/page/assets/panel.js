// The panel beside the map: the ego, its advice, its speed, its slots, alerts. Its elements are made
// once and filled in while the run plays, so that a click or the keyboard never loses its button.

// Why an ego is told what it is told, or nothing.
const WHY = {
  likely_unsafe: 'the likelier slot is not safe', held: 'as told before', far: 'the conflict is far',
  unsure: 'no slot leads by enough', which_gap: 'likely to go, but before whom?',
  settling: 'the choice is still settling',
  unsafe_pass: 'the likely pass is not safe', too_late: 'a yield would be beyond comfort',
  gone_in_time: 'likely to be out before the other comes', in_the_way: 'in the other\u2019s way already',
  other_waits: 'the other is likelier to wait', stands: 'both stand',
  said_otherwise: 'the opposite was said before', mutual: 'the other is told to yield',
  brief: 'over before a driver could react', alerted: 'an alert tells the opposite',
};

// What was said some seconds ago, as it holds now: times in it count down.
function countedDown(text, ago_s) {
  return text.replace(/\bin (\d+(?:\.\d+)?) s\b/g, (_, told) => inSeconds(Number(told) - ago_s));
}

function inSeconds(seconds) {
  return seconds > 0.05 ? `in ${seconds.toFixed(1)} s` : 'now';
}

function swatch(app, vehicle) {
  const made = element('i', { class: 'swatch' });
  made.style.background = vehicle < 0 ? 'none' : `rgb(${app.head.vehicles[vehicle].colour.join(',')})`;
  return made;
}

function makePanel(app) {
  const panel = document.getElementById('panel');
  const block = (title, children) => {
    const heading = element('h3', { textContent: title });
    return { heading, host: element('div', { class: 'block' }, [heading, ...children]) };
  };
  const name = element('h2'), facts = element('p', { class: 'soft' });
  const text = element('p', { class: 'advice' }), why = element('p', { class: 'soft' });
  const advice = block('Advice', [text, why]);
  const canvas = element('canvas', { class: 'speeds', role: 'img', 'aria-label': 'Speed of the ego over time: driven, predicted and advised' });
  const mark = (kind, words) => element('span', { class: 'item' }, [element('i', { class: kind }), words]);
  const advisedKey = mark('advised', 'advised');
  const ahead = element('p', { class: 'soft' });
  const speeds = block('Speed, m/s', [canvas, element('p', { class: 'key' }, [
    mark('driven', 'driven'), mark('predicted', 'predicted'), advisedKey]), ahead]);
  const slotList = element('div'), noSlot = element('p', { class: 'soft' });
  const slots = block('Slots', [slotList, noSlot]);
  const alertList = element('div');
  const alerts = block('Alerts now', [alertList]);
  const hint = element('div', { class: 'hint' }, [
    element('p', { textContent: 'Click a vehicle to make it the ego, press N, or choose one below the map.' }),
    element('p', { class: 'soft', textContent: 'Then the gaps it may take are shaded by probability, and what it is told, and the speed it drives, stand here.' }),
  ]);
  panel.replaceChildren(name, facts, hint, advice.host, alerts.host, speeds.host, slots.host);
  const slotRows = [], alertRows = [];

  function showAdvice(view) {
    // What was advised before an alert is set aside by it: two things told at once contradict.
    const alarmed = view.alerts.some(({ ego, other }) => ego === app.ego || other === app.ego);
    const said = alarmed ? null : view.advice;
    advice.host.hidden = !said;
    if (!said) return;
    const ago = view.time - app.timeOf(said.frame), told = [];
    if (said.target_s !== null) told.push(`at the conflict ${inSeconds(said.target_s - ago)}`);
    if (said.speed_mps !== null) told.push(`${said.speed_mps.toFixed(1)} m/s on the way`);
    if (said.action !== 'abstain' && !said.feasible) told.push('beyond comfort');
    if (said.reason && said.reason !== 'likely') told.push(WHY[said.reason] || said.reason.replaceAll('_', ' '));
    told.push(ago < 0.05 ? 'said just now' : `said ${ago.toFixed(1)} s ago`);
    text.className = `advice ${said.action}`;
    text.textContent = countedDown(said.text, ago);
    why.textContent = told.join(' \u00b7 ');
  }

  function showSlots(view) {
    const told = view.slots.filter((slot) => slot.chance !== null);
    while (slotRows.length < told.length) slotRows.push(slotRow(app, slotList));
    slotRows.forEach((row, i) => row.show(told[i]));
    slots.host.hidden = !view.ego;
    noSlot.hidden = told.length > 0;
    noSlot.textContent = app.head.predictor === null ? 'Nothing was predicted in this run.'
      : 'No choice between slots now.';
  }

  function showAlerts(view) {
    const own = (alert) => alert.ego === app.ego || alert.other === app.ego;
    const now = [...view.alerts].sort((a, b) => own(b) - own(a));
    while (alertRows.length < now.length) alertRows.push(alertRow(app, alertList));
    alertRows.forEach((row, i) => row.show(now[i]));
    alerts.host.hidden = !now.length;
  }

  function showAhead(view) {
    const count = view.ego ? view.ego.chunk.modeCount[view.ego.row] : 0;
    ahead.hidden = !count;
    if (!count) return;
    const flags = view.ego.chunk.flags[view.ego.row];
    const told = modesOf(view.ego).map(({ chance, points }) => {
      const end = points[points.length - 1];
      return `${Math.hypot(end[0] - points[0][0], end[1] - points[0][1]).toFixed(1)} m (${percent(chance)})`;
    });
    const notes = [`in 3 s: ${told.join(', ')}`];
    if (flags & FLAG.fallback) notes.push('no line was found: it goes on as it goes');
    if (flags & FLAG.adapted) notes.push('adapted to this driver');
    ahead.textContent = notes.join(' \u00b7 ');
  }

  return (view) => {
    const ego = app.head.vehicles[app.ego];
    hint.hidden = Boolean(ego);
    name.replaceChildren(...(ego ? [swatch(app, app.ego), shortened(ego.id, 60)] : ['Ego']));
    name.title = ego ? ego.id : '';
    facts.hidden = !ego;
    if (ego) {
      const now = view.ego ? `${view.ego.speed.toFixed(1)} m/s` : 'not in view now';
      facts.textContent = `${ego.kind} \u00b7 ${now} \u00b7 in view ${app.timeOf(ego.first).toFixed(1)} to ${app.timeOf(ego.last).toFixed(1)} s`;
    }
    showAdvice(view);
    showAlerts(view);
    speeds.host.hidden = !view.ego;
    if (view.ego) drawSpeeds(canvas, app, view);
    showAhead(view);
    advisedKey.hidden = !view.advice?.speeds?.length;
    advisedKey.className = `item ${view.advice?.action || ''}`;
    showSlots(view);
  };
}

function slotRow(app, host) {
  let shown = null;
  const name = element('span', { class: 'name' }), value = element('span', { class: 'value' });
  const fill = element('span', { class: 'fill' }), where = element('span', { class: 'where' });
  const row = element('button', { type: 'button', class: 'slot' }, [
    name, value, element('span', { class: 'bar' }, [fill]), where]);
  row.addEventListener('click', () => { if (shown && !shown.own) app.choose(shown.vehicle); });
  host.append(row);
  return {
    show(slot) {
      row.hidden = !slot;
      if (!slot) return;
      if (shown?.vehicle !== slot.vehicle || shown.own !== slot.own) {
        name.replaceChildren(...(slot.own ? ['yield'] : ['before ', swatch(app, slot.vehicle), shortened(nameOf(app, slot.vehicle), 24)]));
      }
      shown = slot;
      fill.style.width = `${100 * slot.chance}%`;
      fill.style.background = chanceColour(slot.chance);
      value.textContent = percent(slot.chance);
      where.textContent = slot.own ? '' : `${slot.merge ? 'merge' : 'crossing'} in ${slot.egoTo.toFixed(0)} m, it is ${slot.rearTo.toFixed(0)} m away`;
    },
  };
}

function alertRow(app, host) {
  let shown = null;
  const row = element('button', { type: 'button', class: 'warning' });
  row.addEventListener('click', () => { if (shown && shown.ego >= 0) app.choose(shown.ego); });
  host.append(row);
  return {
    show(alert) {
      row.hidden = !alert;
      if (!alert || shown === alert) return;
      shown = alert;
      row.replaceChildren(element('strong', { textContent: alert.text }),
        element('span', { textContent: `${shortened(nameOf(app, alert.ego), 30)}, because of ${shortened(nameOf(app, alert.other), 30)}` }));
    },
  };
}
