// Under the map: rows of suggestions, alerts and what really went wrong. A click jumps there.

const TIERS = { T1: 'collision', T2: 'evasive braking', T3: 'close pass' };
const ROW_PX = 22;

function element(tag, properties = {}, children = []) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === 'class') made.className = value;
    else if (name.startsWith('aria-') || name === 'role') made.setAttribute(name, value);
    else made[name] = value;
  }
  made.append(...children);
  return made;
}

function nameOf(app, vehicle) {
  return vehicle < 0 ? 'unknown' : app.head.vehicles[vehicle].id;
}

// All moments worth a jump: {row, from, to, ego, colour, words}, by time.
function momentsOf(app) {
  const { head } = app;
  const end = app.endS;
  const moments = [];
  for (const alert of head.alerts) {
    const words = `${alert.type[0]}${alert.type.slice(1).toLowerCase()}: ${alert.text}`;
    moments.push({
      row: 'alerts', from: alert.from_s, to: alert.to_s ?? end, ego: alert.ego, other: alert.other,
      words, kind: 'alert', more: alert.reason, met: null,
    });
  }
  for (const event of head.events) {
    const apart = event.apart_s === null ? '' : `, ${event.apart_s.toFixed(1)} s apart`;
    moments.push({
      row: 'events', from: event.at_s, to: event.at_s, ego: event.first, other: event.second,
      kind: event.tier, words: `${event.tier} ${TIERS[event.tier]}`,
      more: `${event.cause}${apart}`, met: event.met_m,
    });
  }
  return moments.sort((a, b) => a.from - b.from);
}

// Stretches of advice for one ego.
function adviceOf(app, ego) {
  const own = app.head.advice.filter((change) => change.ego === ego);
  const last = ego < 0 ? 0 : app.head.vehicles[ego].last + 1;
  return own.map((change, i) => ({
    ...change, until: i + 1 < own.length ? own[i + 1].frame : Math.max(last, change.frame),
  })).filter((change) => change.action);
}

function standingAdvice(app, frame) {
  return app.egoAdvice.find((change) => change.frame <= frame && frame < change.until) || null;
}

const ACTION_COLOURS = { yield: '#0072b2', pass: '#009e73', abstain: '#8a8f94' };
const ACTION_WORDS = { yield: 'yield', pass: 'pass', abstain: 'watch, no advice' };

// What the colours of the row of advice mean, and the signs of those of alerts and events.
function timelineKey(app) {
  const made = element('p', { class: 'key timeline-key' });
  for (const [action, words] of Object.entries(ACTION_WORDS)) {
    const mark = element('i', { class: 'block-mark' });
    mark.style.background = ACTION_COLOURS[action];
    made.append(element('span', { class: 'item' }, [mark, words]));
  }
  const kinds = Object.keys(KINDS).filter((kind) => app.moments.some((moment) => moment.kind === kind));
  for (const kind of kinds) {
    made.append(element('span', { class: `item kind ${kind}` }, [
      element('span', { textContent: KINDS[kind].glyph }), KINDS[kind].words]));
  }
  return made;
}

function timelineOf(app, jump) {
  const host = document.getElementById('timeline');
  const canvas = element('canvas', { tabIndex: 0, role: 'slider', 'aria-label': 'Timeline: advice of the ego, alerts, events. Arrow keys move, Page Up and Page Down jump to the moment before or after.' });
  const tip = element('div', { class: 'tip', hidden: true });
  host.append(canvas, tip);
  host.after(timelineKey(app));
  const rows = ['advice', 'alerts', 'events'];
  const counts = Object.fromEntries(rows.map((row) => [row, app.moments.filter((moment) => moment.row === row).length]));
  const left = 76, right = 8;
  let width = 1;
  const xOf = (seconds) => left + ((seconds - app.startS) / Math.max(app.endS - app.startS, 0.1)) * (width - left - right);
  const ground = (ctx, { soft, faint, ink }) => {
    ctx.font = '12px system-ui, sans-serif';
    ctx.textBaseline = 'middle';
    rows.forEach((row, i) => {
      const middle = i * ROW_PX + ROW_PX / 2;
      ctx.fillStyle = ink;
      ctx.fillText(row, 0, middle);
      ctx.fillStyle = soft;
      ctx.textAlign = 'right';
      if (row !== 'advice') ctx.fillText(String(counts[row]), left - 8, middle);
      ctx.textAlign = 'start';
      ctx.fillStyle = faint;
      ctx.fillRect(left, i * ROW_PX + 3, width - left - right, ROW_PX - 6);
    });
    if (app.ego < 0) {
      ctx.fillStyle = soft;
      ctx.fillText('of the ego: none is chosen', left + 8, ROW_PX / 2 + 0.5);
    }
  };
  const draw = (seconds) => {
    const ratio = window.devicePixelRatio || 1;
    width = Math.max(host.clientWidth, 120);
    const height = rows.length * ROW_PX + 18;
    if (canvas.width !== Math.round(width * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.style.height = `${height}px`;
    }
    const ctx = canvas.getContext('2d');
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, width, height);
    const style = getComputedStyle(document.documentElement);
    const colours = Object.fromEntries(['ink', 'soft', 'line', 'card', 'alarm', 'event'].map((name) => [name, style.getPropertyValue(`--${name}`)]));
    ground(ctx, { ...colours, faint: colours.line });
    for (const change of app.egoAdvice) {
      const x = xOf(app.timeOf(change.frame)), w = Math.max(xOf(app.timeOf(change.until)) - x, 2);
      ctx.fillStyle = ACTION_COLOURS[change.action] || colours.soft;
      ctx.fillRect(x, 4, w, ROW_PX - 8);
    }
    for (const moment of app.moments) {
      const y = rows.indexOf(moment.row) * ROW_PX, x = xOf(moment.from);
      const own = app.ego < 0 || moment.ego === app.ego || moment.other === app.ego;
      ctx.globalAlpha = own ? 1 : 0.5;
      ctx.fillStyle = ctx.strokeStyle = moment.kind === 'alert' || moment.kind === 'T1' ? colours.alarm : colours.event;
      if (moment.row === 'alerts') ctx.fillRect(x, y + 4, Math.max(xOf(moment.to) - x, 3), ROW_PX - 8);
      else drawMark(ctx, x, y + ROW_PX / 2, moment.kind, colours.card);
      ctx.globalAlpha = 1;
    }
    drawTicks(ctx, app, xOf, rows.length * ROW_PX, colours.soft);
    const x = xOf(seconds);
    ctx.fillStyle = colours.card;
    ctx.fillRect(x - 2, 0, 4, rows.length * ROW_PX);
    ctx.fillStyle = colours.ink;
    ctx.fillRect(x - 1, 0, 2, rows.length * ROW_PX);
    canvas.setAttribute('aria-valuenow', seconds.toFixed(1));
    canvas.setAttribute('aria-valuemin', app.startS.toFixed(1));
    canvas.setAttribute('aria-valuemax', app.endS.toFixed(1));
  };
  const nearest = (x, y) => {
    const row = rows[Math.floor(y / ROW_PX)];
    let best = null, away = 7;
    for (const moment of app.moments) {
      if (moment.row !== row) continue;
      const from = xOf(moment.from), to = Math.max(xOf(moment.to), from);
      const off = x < from ? from - x : Math.max(x - to, 0);
      if (off < away) { away = off; best = moment; }
    }
    return best;
  };
  const secondsAt = (x) => Math.min(Math.max(app.startS + ((x - left) / (width - left - right)) * (app.endS - app.startS), app.startS), app.endS);
  canvas.addEventListener('click', (event) => {
    const moment = nearest(event.offsetX, event.offsetY);
    if (moment) jump(moment.from, moment.ego, moment);
    else if (event.offsetX >= left - 4) jump(secondsAt(event.offsetX), null);
  });
  const tell = (x, y) => {
    const moment = nearest(x, y);
    const change = y < ROW_PX ? app.egoAdvice.find(({ frame, until }) =>
      xOf(app.timeOf(frame)) <= x && x < xOf(app.timeOf(until))) : null;
    canvas.style.cursor = moment || x >= left ? 'pointer' : 'default';
    if (moment) return `${moment.from.toFixed(1)} s \u00b7 ${moment.words} \u00b7 ${shortened(nameOf(app, moment.ego), 30)}`;
    if (change) return `${app.timeOf(change.frame).toFixed(1)} s \u00b7 ${change.text}`;
    return x >= left ? `${secondsAt(x).toFixed(1)} s` : '';
  };
  canvas.addEventListener('pointermove', (event) => {
    const words = tell(event.offsetX, event.offsetY);
    tip.hidden = !words;
    tip.textContent = words;
    const at = Math.min(Math.max(event.offsetX - tip.offsetWidth / 2, 0), width - tip.offsetWidth);
    Object.assign(tip.style, { left: `${at}px`, bottom: `${host.clientHeight - event.offsetY + 14}px` });
  });
  canvas.addEventListener('pointerleave', () => { tip.hidden = true; });
  return { draw };
}

// Three tiers, three shapes: a cross, a triangle, a circle; those that lie over others keep an edge.
function drawMark(ctx, x, y, tier, edge) {
  const colour = ctx.strokeStyle;
  ctx.beginPath();
  if (tier === 'T1') {
    ctx.moveTo(x - 5, y - 5); ctx.lineTo(x + 5, y + 5);
    ctx.moveTo(x + 5, y - 5); ctx.lineTo(x - 5, y + 5);
    for (const [thick, paint] of [[6, edge], [3, colour]]) {
      ctx.lineWidth = thick;
      ctx.strokeStyle = paint;
      ctx.stroke();
    }
    return;
  }
  if (tier === 'T2') {
    ctx.moveTo(x, y - 6); ctx.lineTo(x + 5.5, y + 5); ctx.lineTo(x - 5.5, y + 5);
    ctx.closePath();
    ctx.fill();
    ctx.strokeStyle = edge;
    ctx.lineWidth = 1;
  } else {
    ctx.arc(x, y, 3.5, 0, 2 * Math.PI);
    ctx.fillStyle = edge;
    ctx.fill();
    ctx.lineWidth = 2;
  }
  ctx.stroke();
}

function drawTicks(ctx, app, xOf, y, colour) {
  const span = app.endS - app.startS;
  const step = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200].find((s) => span / s <= 8) || 3600;
  ctx.fillStyle = colour;
  ctx.textAlign = 'center';
  for (let s = Math.ceil(app.startS / step) * step; s <= app.endS; s += step) {
    ctx.fillRect(xOf(s), y, 1, 4);
    ctx.fillText(`${s} s`, Math.min(xOf(s), xOf(app.endS) - 8), y + 11);
  }
  ctx.textAlign = 'start';
}
