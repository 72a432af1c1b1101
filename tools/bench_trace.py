#!/usr/bin/env python3
"""ridged trace against Mitsuba 3 on one and the same height field, in one run.

A 400 x 400 Beckmann field (alpha 0.4), light at 45 degrees, at most 8 bounces, 4 x 4 Mueller matrices into 45 x 180
direction bins. Mitsuba traces the field with its llvm_ad_mono_polarized variant as a symbolic loop of forward photons
(smooth dielectric or conductor on every facet); ridged reads the same heights from a file. Both are run for --seeds
seeds on the one surface: the variance of a bin is that over the seeds, of its share of the light (m00), summed over the
bins of the upper side, times the time of a run. Also: launched photons per second with every photon going one way
(method "analog"), a new surface with a million photons, and the errors by sampling and by surface told apart.

  python tools/bench_trace.py --ridged target/release/ridged [--json FILE] [--quick]

Needs mitsuba 3.9 and numpy (make bench-peers-trace sets both up) and a libLLVM (Debian: libllvm19).
"""
import argparse, json, os, subprocess, sys, tempfile, time
import numpy as np

NT, NP = 45, 180
N, ALPHA, CORR, ANGLE, DEPTH = 400, 0.4, 10.0, 45.0, 8
MATERIALS = {'dielectric': '{ n = 1.5 }', 'conductor': '{ n = 0.18, k = 3.4 }'}


def heights(seed):
    """Periodic Gaussian field, autocorrelation exp(-r^2/CORR^2) in cells, slopes per axis N(0, ALPHA^2/2)."""
    rng = np.random.default_rng(seed)
    f = 2*np.pi*np.fft.fftfreq(N)
    kx, ky = np.meshgrid(f, f, indexing='ij')
    amp = np.exp(-(kx**2 + ky**2)*CORR**2/8)
    h = np.fft.ifft2(np.fft.fft2(rng.standard_normal((N, N)))*amp).real
    h -= h.mean()
    s = np.sqrt(0.5*(np.diff(h, axis=0).var() + np.diff(h, axis=1).var()))
    return h*(ALPHA/np.sqrt(2))/s


class Mitsuba:
    def __init__(self, h, material):
        import drjit as dr
        import mitsuba as mi
        mi.set_variant('llvm_ad_mono_polarized')
        mi.set_log_level(mi.LogLevel.Error)
        self.mi, self.dr = mi, dr
        x = np.arange(N) - (N - 1)/2
        X, Y = np.meshgrid(x, x, indexing='ij')
        v = np.stack([X, Y, h], -1).reshape(-1, 3).astype(np.float32)
        i = np.arange(N*N).reshape(N, N)
        a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
        f = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).astype(np.uint32)
        props = mi.Properties()
        props['bsdf'] = mi.load_dict({'type': 'dielectric', 'int_ior': 1.5, 'ext_ior': 1.0} if material == 'dielectric'
                                     else {'type': 'conductor', 'eta': 0.18, 'k': 3.4})
        props['face_normals'] = True
        mesh = mi.Mesh('field', vertex_count=len(v), face_count=len(f), props=props)
        p = mi.traverse(mesh)
        p['vertex_positions'] = v.ravel()
        p['faces'] = f.ravel()
        p.update()
        self.scene = mi.load_dict({'type': 'scene', 'field': mesh})

    def run(self, count, seed):
        mi, dr, scene = self.mi, self.dr, self.scene
        t = np.radians(ANGLE)
        d = mi.Vector3f(float(-np.sin(t)), 0.0, float(-np.cos(t)))
        pcg = mi.PCG32(size=count, initstate=seed)
        z = 6.0*ALPHA*CORR
        # Light falls on the middle half of the field, so that nothing leaves at its rims.
        x, y = (pcg.next_float32() - 0.5)*(N/2), (pcg.next_float32() - 0.5)*(N/2)
        ray = mi.Ray3f(mi.Point3f(x, y, 0) - d*float(z/np.cos(t)), d)
        ctx = mi.BSDFContext(mi.TransportMode.Importance)
        beta, hits, active = mi.Spectrum(1.0), mi.UInt32(0), mi.Bool(True)

        def body(ray, pcg, beta, hits, active):
            si = scene.ray_intersect(ray, active)
            active = active & si.is_valid()
            u, v, w = pcg.next_float32(active), pcg.next_float32(active), pcg.next_float32(active)
            bs, m = si.bsdf().sample(ctx, si, u, mi.Point2f(v, w), active)
            m = si.to_world_mueller(m, -si.wi, bs.wo)
            beta = dr.select(active, m @ beta, beta)
            hits = hits + dr.select(active, mi.UInt32(1), mi.UInt32(0))
            ray = dr.select(active, si.spawn_ray(si.to_world(bs.wo)), ray)
            return ray, pcg, beta, hits, active & (hits < DEPTH)
        ray, _, beta, hits, _ = dr.while_loop((ray, pcg, beta, hits, active), lambda r, p, b, h, act: act, body)
        bins = dr.zeros(mi.Float, NT*NP*16)
        th, ph = dr.acos(dr.clip(ray.d.z, -1, 1)), dr.atan2(ray.d.y, ray.d.x)
        ph = dr.select(ph < 0, ph + float(2*np.pi), ph)
        up = ray.d.z > 0
        b = dr.minimum(mi.UInt32(th*float(NT/(np.pi/2))), NT - 1)*NP + dr.minimum(mi.UInt32(ph*float(NP/(2*np.pi))), NP - 1)
        for i in range(4):
            for j in range(4):
                e = beta[i, j]
                e = e if isinstance(e, mi.Float) else e[0]
                dr.scatter_add(bins, e, b*16 + 4*i + j, up)
        dr.eval(bins)
        dr.sync_thread()
        return np.array(bins).reshape(NT*NP, 16)[:, 0]/count


class Ridged:
    def __init__(self, program, folder, material, surface):
        self.program, self.folder, self.material = program, folder, material
        self.surface = surface

    def run(self, count, seed, method, bins=True):
        scene = os.path.join(self.folder, 'scene.toml')
        with open(scene, 'w') as f:
            f.write(f'[light]\ntheta_i_deg = {ANGLE}\n[[interface]]\n{self.surface}\nbelow = {MATERIALS[self.material]}\n'
                    f'[run]\nphotons = {count}\nseed = {seed}\nmethod = "{method}"\ninteractions_max = {DEPTH}\n')
        out = os.path.join(self.folder, 'bins.csv')
        command = [self.program, 'trace', scene, '--json'] + (['--out', out] if bins else [])
        t = time.perf_counter()
        report = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        report['whole_s'] = time.perf_counter() - t
        if not bins:
            return None, report
        table = np.genfromtxt(out, delimiter=',', usecols=(1, 2, 5), skip_header=1, max_rows=NT*NP)
        lo, hi = np.radians(table[:, 0]), np.radians(table[:, 1])
        omega = 0.5*(np.sin(hi)**2 - np.sin(lo)**2)*2*np.pi/NP
        return table[:, 2]*omega, report


def spread(runs):
    return float(np.var(np.array(runs), axis=0, ddof=1).sum())


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument('--ridged', default='target/release/ridged')
    p.add_argument('--json')
    p.add_argument('--seeds', type=int, default=16)
    p.add_argument('--quick', action='store_true', help='a tenth of the photons and 4 seeds: to see that it runs')
    a = p.parse_args()
    scale, seeds = (10, 4) if a.quick else (1, a.seeds)
    mi_photons, split, analog = 4194304//scale, 24_000_000//scale, 16_000_000//scale
    h = heights(1)
    report = {'cores': os.cpu_count(), 'loadavg_before': os.getloadavg(), 'seeds': seeds, 'materials': {}}
    with tempfile.TemporaryDirectory() as folder:
        # Rows along v, columns along u; seventeen digits: both programs round to float32 themselves.
        np.savetxt(os.path.join(folder, 'field.csv'), h.T, fmt='%.17g', delimiter=',')
        field = 'shape = "file"\npath = "field.csv"\npitch_um = 1.0\nheight_unit_um = 1.0'
        for material in MATERIALS:
            peer, ours = Mitsuba(h, material), Ridged(a.ridged, folder, material, field)
            peer.run(mi_photons, 1000)
            theirs, mine, fast, their_s, my_s, setup, fast_s = [], [], [], [], [], [], []
            # In turn, so that other work on the machine hits both alike.
            for seed in range(seeds):
                t = time.perf_counter()
                theirs.append(peer.run(mi_photons, 1 + seed))
                their_s.append(time.perf_counter() - t)
                b, r = ours.run(split, 1 + seed, 'split')
                mine.append(b)
                my_s.append(r['run_seconds'] - r['setup_seconds'])
                setup.append(r['setup_seconds'])
                _, r = ours.run(analog, 1 + seed, 'analog', bins=False)
                fast_s.append(r['run_seconds'] - r['setup_seconds'])
            v_theirs, v_mine = spread(theirs), spread(mine)
            t_theirs, t_mine, t_fast = np.median(their_s), np.median(my_s), np.median(fast_s)
            report['materials'][material] = dict(
                mitsuba=dict(photons=mi_photons, seconds=t_theirs, photons_per_s=mi_photons/t_theirs, variance=v_theirs,
                             reflected=float(np.mean(theirs, axis=0).sum())),
                ridged=dict(photons=split, seconds=t_mine, setup_s=float(np.median(setup)), variance=v_mine,
                            reflected=float(np.mean(mine, axis=0).sum()),
                            analog_photons_per_s=analog/t_fast),
                variance_at_equal_time=v_theirs*t_theirs/(v_mine*t_mine),
                variance_with_setup=v_theirs*t_theirs/(v_mine*(t_mine + np.median(setup))),
                analog_speed=(analog/t_fast)/(mi_photons/t_theirs))
        new = []
        for seed in range(3 if a.quick else 9):
            ours = Ridged(a.ridged, folder, 'dielectric',
                          f'shape = "beckmann"\nalpha_u = {ALPHA}\nalpha_v = {ALPHA}\nseed = {seed}')
            _, r = ours.run(1_000_000, 1, 'split', bins=False)
            reflected = r['energy']['reflected']
            new.append((r['run_seconds'] + r['surface_seconds'], reflected['value'], reflected['std'],
                        r['surface_seconds'], r['setup_seconds'], r['run_seconds'] - r['setup_seconds']))
        new = np.array(new)
        making, looking, tracing = np.median(new[:, 3:], axis=0)
        report['new_surface_with_1M_photons'] = dict(seconds=float(np.median(new[:, 0])), surfaces=len(new),
                                                     surface_s=making, setup_s=looking, photons_s=tracing,
                                                     reflected_std_by_sampling=float(np.mean(new[:, 2])),
                                                     reflected_std_between_surfaces=float(new[:, 1].std(ddof=1)))
    report['loadavg_after'] = os.getloadavg()
    for material, m in report['materials'].items():
        print(f"{material}: Mitsuba {m['mitsuba']['photons_per_s']/1e6:.2f} M photons/s, ridged analog "
              f"{m['ridged']['analog_photons_per_s']/1e6:.2f} M/s = {m['analog_speed']:.1f} times; variance at equal time "
              f"{m['variance_at_equal_time']:.0f} times lower (set-up {m['ridged']['setup_s']:.3f} s apart; with it {m['variance_with_setup']:.0f} times); reflected "
              f"{m['mitsuba']['reflected']:.5f} and {m['ridged']['reflected']:.5f} (middle half and whole field)")
    n = report['new_surface_with_1M_photons']
    print(f"a new surface with 1 M photons: {n['seconds']:.3f} s (the surface {n['surface_s']:.3f} s, set-up {n['setup_s']:.3f} s, "
          f"photons {n['photons_s']:.3f} s); error of the reflected energy by sampling "
          f"{n['reflected_std_by_sampling']:.1e}, spread between {n['surfaces']} surfaces {n['reflected_std_between_surfaces']:.1e}")
    if a.json:
        with open(a.json, 'w') as f:
            json.dump(report, f, indent=1)


if __name__ == '__main__':
    sys.exit(main())
