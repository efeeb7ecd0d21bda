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
    const words = `${alert.type.toLowerCase()}: ${alert.text}`;
    moments.push({
      row: 'alerts', from: alert.from_s, to: alert.to_s ?? end, ego: alert.ego, other: alert.other,
      colour: ALARM, words, kind: 'alert', more: alert.reason,
    });
  }
  for (const event of head.events) {
    const apart = event.apart_s === null ? '' : `, ${event.apart_s.toFixed(1)} s apart`;
    moments.push({
      row: 'events', from: event.at_s, to: event.at_s, ego: event.first, other: event.second,
      colour: EVENT, kind: event.tier, words: `${event.tier} ${TIERS[event.tier]}`,
      more: `${event.cause}${apart}`,
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

function timelineOf(app, jump) {
  const host = document.getElementById('timeline');
  const canvas = element('canvas', { tabIndex: 0, role: 'slider', 'aria-label': 'Timeline: advice of the ego, alerts, events. Arrow keys move, Page Up and Page Down jump to the moment before or after.' });
  host.append(canvas);
  const rows = ['advice', 'alerts', 'events'];
  const left = 58;
  let width = 1;
  const xOf = (seconds) => left + ((seconds - app.startS) / Math.max(app.endS - app.startS, 0.1)) * (width - left - 8);
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
    const [ink, soft, faint] = ['--ink', '--soft', '--line'].map((name) => style.getPropertyValue(name));
    ctx.font = '11px system-ui, sans-serif';
    ctx.textBaseline = 'middle';
    rows.forEach((row, i) => {
      ctx.fillStyle = soft;
      ctx.fillText(row, 2, i * ROW_PX + ROW_PX / 2);
      ctx.fillStyle = faint;
      ctx.fillRect(left, i * ROW_PX + 3, width - left - 8, ROW_PX - 6);
    });
    for (const change of app.egoAdvice) {
      const x = xOf(app.timeOf(change.frame)), w = Math.max(xOf(app.timeOf(change.until)) - x, 2);
      ctx.fillStyle = ACTION_COLOURS[change.action] || soft;
      ctx.fillRect(x, 4, w, ROW_PX - 8);
    }
    for (const moment of app.moments) {
      const y = rows.indexOf(moment.row) * ROW_PX, x = xOf(moment.from);
      const own = moment.ego === app.ego || moment.other === app.ego;
      ctx.fillStyle = moment.colour;
      ctx.globalAlpha = own ? 1 : 0.55;
      if (moment.row === 'alerts') ctx.fillRect(x, y + 4, Math.max(xOf(moment.to) - x, 3), ROW_PX - 8);
      else drawMark(ctx, x, y + ROW_PX / 2, moment.kind);
      ctx.globalAlpha = 1;
    }
    drawTicks(ctx, app, xOf, rows.length * ROW_PX, soft);
    ctx.fillStyle = ink;
    ctx.fillRect(xOf(seconds) - 1, 0, 2, rows.length * ROW_PX);
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
  canvas.addEventListener('click', (event) => {
    const moment = nearest(event.offsetX, event.offsetY);
    if (moment) return jump(moment.from, moment.ego);
    const seconds = app.startS + ((event.offsetX - left) / (width - left - 8)) * (app.endS - app.startS);
    return jump(seconds, null);
  });
  canvas.addEventListener('mousemove', (event) => {
    const moment = nearest(event.offsetX, event.offsetY);
    canvas.title = moment ? `${moment.from.toFixed(1)} s  ${moment.words}` : '';
    canvas.style.cursor = moment ? 'pointer' : 'default';
  });
  return { draw };
}

// Three tiers, three shapes: a cross, a triangle, a circle.
function drawMark(ctx, x, y, tier) {
  ctx.beginPath();
  if (tier === 'T1') {
    ctx.lineWidth = 3;
    ctx.strokeStyle = ALARM;
    ctx.moveTo(x - 5, y - 5); ctx.lineTo(x + 5, y + 5);
    ctx.moveTo(x + 5, y - 5); ctx.lineTo(x - 5, y + 5);
    ctx.stroke();
  } else if (tier === 'T2') {
    ctx.moveTo(x, y - 6); ctx.lineTo(x + 6, y + 5); ctx.lineTo(x - 6, y + 5);
    ctx.fill();
  } else {
    ctx.arc(x, y, 4, 0, 2 * Math.PI);
    ctx.fill();
  }
}

function drawTicks(ctx, app, xOf, y, colour) {
  const span = app.endS - app.startS;
  const step = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200].find((s) => span / s <= 8) || 3600;
  ctx.fillStyle = colour;
  ctx.textAlign = 'center';
  for (let s = Math.ceil(app.startS / step) * step; s <= app.endS; s += step) {
    ctx.fillRect(xOf(s), y, 1, 4);
    ctx.fillText(`${s} s`, xOf(s), y + 11);
  }
  ctx.textAlign = 'start';
}
