// The rig: its state, moves, jogs, the stop and previews.

import type { Ask } from '../ask';
import type { MockLab } from '../lab';
import { lookThrough, picture } from '../preview';

export function answerRig(lab: MockLab, { method, path, body, send, problem }: Ask): boolean {
  if (path === '/rig') {
    // A reading connects stages that are not in use.
    if (lab.plugged && lab.rigBody()['scan_id'] === null) lab.connected = true;
    return send(200, lab.rigBody());
  }
  const lookMatch = /^\/rig\/preview\/(\d+)\/image\.png$/.exec(path);
  if (lookMatch) return send(200, picture(Number(lookMatch[1])), 'image/png');
  if (path === '/rig/preview') {
    if (lab.rigBody()['activity'] !== 'idle') return problem(409, 'busy', 'the rig is busy: scan 1 holds the rig until its end; stop is always allowed');
    lab.looks += 1;
    return send(200, lookThrough(lab.looks, body['exposures_s'] as number[], Number(body['suggest'] ?? 1), { theta_c_deg: lab.axes.theta_c.position_deg, referenced: lab.axes.theta_c.referenced }));
  }
  // Orders reconnect a lost link if the stages can be connected.
  if (method === 'POST' && (path.startsWith('/rig/') || path === '/scans') && !lab.connected) {
    if (!lab.plugged) return problem(503, 'port-missing', 'the serial port /dev/ttyUSB0 does not exist: plug the stage in or correct [bench] port');
    lab.connected = true;
  }
  if (path === '/rig/stop') {
    for (const axis of Object.values(lab.axes)) axis.moving = false;
    for (const scan of lab.scans) {
      if (scan.body.state === 'running') {
        scan.body.state = 'paused';
        scan.body['reason'] = 'stopped';
        lab.publish(scan);
      }
    }
    lab.event('rig', {});
    return send(200, { state: 'stopped' });
  }
  if (path === '/rig/home') {
    for (const axis of Object.values(lab.axes)) axis.moving = true;
    lab.after(400, () => {
      for (const axis of Object.values(lab.axes)) Object.assign(axis, { moving: false, homed: true, position_deg: 0 });
      lab.event('rig', {});
    });
    return send(202, { id: null, state: 'homing' });
  }
  if (path === '/rig/jog') {
    const axis = lab.axes[body['axis'] as 'theta_c' | 'phi_s'];
    axis.moving = Number(body['speed_deg_s']) !== 0;
    return send(200, { jog: 1, ended: !axis.moving, at_end: null });
  }
  if (path === '/rig/move') {
    const to = { theta_c: Number(body['theta_c_deg']), phi_s: Number(body['phi_s_deg']) };
    for (const axis of Object.values(lab.axes)) axis.moving = true;
    lab.after(400, () => {
      for (const name of ['theta_c', 'phi_s'] as const) Object.assign(lab.axes[name], { moving: false, position_deg: to[name] });
      lab.event('rig', {});
    });
    return send(202, { id: 1, state: 'moving' });
  }
  const axisMatch = /^\/rig\/axes\/(theta_c|phi_s)\/(move|home)$/.exec(path);
  if (axisMatch) {
    const axis = lab.axes[axisMatch[1] as 'theta_c' | 'phi_s'];
    const target = axisMatch[2] === 'home' ? 0 : Number(body['position_deg']);
    axis.moving = true;
    lab.after(400, () => {
      if (!axis.moving) return;
      axis.moving = false;
      axis.homed = true;
      axis.referenced = true;
      axis.position_deg = target;
      lab.event('rig', {});
    });
    return send(202, { id: null, state: 'moving' });
  }
  return false;
}
