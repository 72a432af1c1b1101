#!/usr/bin/env python3
"""Writes tests/data/extreme/*.csv: stiff and extreme cases of the closed forms in 60-digit arithmetic.

An independent transcription (mpmath) of the printed BRDF (Luongo et al. 2017, Eqs. 1-6), the full
sawtooth (docs/explanation/sawtooth.md), Fresnel reflectances, flat incoherent stacks and the sawtooth's
visibility. Inputs are exact doubles. `cond` is the relative condition number of the value, the sum
over all inputs x of |x df/dx / f| (angles included). Needs: pip install mpmath

    python3 tools/extreme_reference.py            # from the repository's root
    python3 tools/extreme_reference.py --check    # compares the transcription with tests/data instead
"""

import csv
import math
import pathlib
import sys

from mpmath import mp, mpf, mpc

mp.dps = 60
ROOT = pathlib.Path(__file__).resolve().parent.parent / "tests" / "data"
ZERO, ONE = mpf(0), mpf(1)


def fresnel(cos, eta, k):
    """(R_s, R_p) of the index eta + ik at cos theta."""
    n2 = mpc(eta, k) ** 2
    q = mp.sqrt(n2 - 1 + cos * cos)
    if q.imag < 0 or (q.imag == 0 and q.real < 0):
        q = -q
    if n2 == 1:
        return ZERO, ZERO
    rs = (cos - q) / (cos + q)
    rp = (n2 * cos - q) / (n2 * cos + q)
    return abs(rs) ** 2, abs(rp) ** 2


def mean(pair):
    return (pair[0] + pair[1]) / 2


def direction(theta, phi):
    return [mp.sin(theta) * mp.cos(phi), mp.sin(theta) * mp.sin(phi), mp.cos(theta)]


def brdf(theta_i, phi_i, theta_o, phi_o, theta_r, alpha_u, alpha_v, rho_d, eta, k):
    i, o = direction(theta_i, phi_i), direction(theta_o, phi_o)
    s, c = mp.sin(theta_r), mp.cos(theta_r)

    def g1(w):
        # theta_p - theta_r as the angle between the projection and the pitch normal.
        along, across = w[1] * s + w[2] * c, w[1] * c - w[2] * s
        if along <= 0:
            return ZERO
        return max(ZERO, 1 - abs(s / c * across / along))

    h = [a + b for a, b in zip(i, o)]
    size = mp.sqrt(sum(x * x for x in h))
    h = [x / size for x in h]
    hm, he = h[1] * s + h[2] * c, h[1] * c - h[2] * s
    if hm <= 0:
        return ZERO
    d = mp.exp(-((h[0] / hm / alpha_u) ** 2 + (he / hm / alpha_v) ** 2)) / (
        mp.pi * alpha_u * alpha_v * hm**4
    )
    f = mean(fresnel(sum(a * b for a, b in zip(i, h)), eta, k))
    return g1(i) * g1(o) * d / (4 * i[2] * o[2]) * (f + rho_d / mp.pi * (1 - f) ** 2)


def sawtooth(theta_i, phi_i, theta_o, phi_o, theta_r, alpha_u, alpha_v, rho_d, eta, k, theta_l=None, lamp=0, a=1):
    """Radiance for irradiance 1 facing the lamp, docs/explanation/sawtooth.md."""
    theta_l = mpf(THETA_L) if theta_l is None else theta_l
    i, o = direction(theta_i, phi_i), direction(theta_o, phi_o)
    return sawtooth_of(i, o, theta_r, alpha_u, alpha_v, rho_d, eta, k, theta_l, mpf(lamp), mpf(a))


def sawtooth_of(i, o, theta_r, alpha_u, alpha_v, rho_d, eta, k, theta_l, lamp, a):
    p, r = mp.cos(theta_r), mp.sin(theta_r)
    tan = r / p

    class Ray:
        def __init__(self, w):
            self.u, self.e, m = w[0], w[1] * p - w[2] * r, w[1] * r + w[2] * p
            self.m = max(ZERO, m)
            self.rho = max(ZERO, -self.e)
            self.sigma = p if m <= 0 else p * min(ONE, max(ZERO, tan * max(ZERO, self.e) / m))
            self.x = self.y = ZERO
            if self.rho > 0:
                self.x = min(p, r * self.rho / self.m) if self.m > 0 else p
                self.y = min(r, p * self.m / self.rho)
            self.fr, self.rr = fresnel(self.m, eta, k), fresnel(self.rho, eta, k)
            self.ff, self.fr_ = mean(self.fr), mean(self.rr)
            self.tf, self.tr = 1 - self.ff, 1 - self.fr_

    A, B = Ray(i), Ray(o)
    au2, av2 = alpha_u**2 + lamp**2 / 8, alpha_v**2 + lamp**2 / 8

    def lobe(x, y, z, size2):
        return mp.exp(-(x * x / au2 + y * y / av2) / z**2) / (mp.pi * mp.sqrt(au2 * av2)) * size2**2 / z**4

    h = [x + y for x, y in zip(i, o)]
    h2 = sum(x * x for x in h)
    hm, he = h[1] * r + h[2] * p, h[1] * p - h[2] * r
    f = mean(fresnel(mp.sqrt(h2) / 2, eta, k))
    total = ZERO
    seen = p - max(A.sigma, B.sigma)
    if A.m > 0 and B.m > 0 and hm > 0 and seen > 0:
        total += a * seen * f * lobe(h[0], he, hm, h2) / 4
    if A.rho > 0 and B.rho > 0:
        total += a * r * f * lobe(h[0], hm, -he, h2) / 4
    if rho_d != 0:
        t1 = 1 - mean(fresnel(ONE, eta, k))
        tl = 1 - mean(fresnel(mp.cos(theta_l), eta, k))
        cd = rho_d / (mp.pi * t1 * tl)
        pos = lambda x: max(ZERO, x)
        d = pos(seen) * A.tf * B.tf * A.m * B.m + r * A.tr * B.tr * A.rho * B.rho
        for one, two in ((A, B), (B, A)):
            d += one.fr_ * one.tf * one.m * pos(one.x - two.sigma) * two.tf * two.m
            d += one.ff * one.tr * one.rho * one.y * two.tr * two.rho
        d += A.fr_ * A.tf * A.m * B.fr_ * B.tf * B.m * min(A.x, B.x)
        d += A.ff * A.tr * A.rho * B.ff * B.tr * B.rho * min(A.y, B.y)
        if r > 0:
            tbar = diffuse_transmittance(eta, k)
            kappa = mp.pi * cd * tbar**2
            gap = p + r - 1
            ffr, frf = gap / (2 * p), gap / (2 * r)
            ef = lambda w: w.tf * w.m * (p - w.sigma + w.fr_ * w.x)
            er = lambda w: w.tr * w.rho * (r + w.ff * w.y)
            den = 1 - kappa**2 * ffr * frf
            df = (ef(A) + kappa * frf * er(A)) / den - ef(A)
            dr = (er(A) + kappa * ffr * ef(A)) / den - er(A)
            d += ef(B) * df / p + er(B) * dr / r
        total += cd * d
    for one, two in ((A, B), (B, A)):
        if one.m <= 0 or two.rho <= 0 or r <= 0:
            continue
        b1, b2 = mp.atan2(one.e, one.m), mp.atan2(two.e, two.m)
        b = -(b1 + b2) / 2
        if one.sigma == 0:
            length = r
        else:
            kept = mp.tan(min(max(b, mpf("0.02")), mpf("1.5")))
            length = max(ZERO, min(r, p / kept) - one.sigma / kept)
        vu = alpha_u**2 * (one.m**2 + two.rho**2) / 2 + lamp**2 / 16
        vv = alpha_v**2 + lamp**2 / 16
        if k > 0:
            ff = (one.fr[0] * two.rr[0] + one.fr[1] * two.rr[1]) / 2
        else:
            ff = one.ff * two.fr_
        normal = lambda x, v: mp.exp(-x * x / (2 * v)) / mp.sqrt(2 * mp.pi * v)
        total += (
            a * a * length * mp.ncdf(b / alpha_v) * ff / 4 * two.rho
            * normal((one.u + two.u) / 2, vu) * normal((b2 - b1) / 2, vv)
        )
    return total / o[2]


_TBAR = {}


def diffuse_transmittance(eta, k):
    key = (mp.nstr(eta, 55), mp.nstr(k, 55))
    if key not in _TBAR:
        integrand = lambda mu: 2 * mu * (1 - mean(fresnel(mu, eta, k)))
        small = mp.sqrt(abs(eta - 1)) if eta != 1 else mpf("0.1")
        cuts = {ZERO, min(small, mpf("0.5")), min(4 * small, mpf("0.6")), mpf("0.7"), ONE}
        if eta < 1 and k == 0:
            # Total reflection up to the critical angle, a root from there on.
            mu = lambda g: mp.sqrt(eta**2 * g * g + 1 - eta**2)
            _TBAR[key] = mp.quad(lambda g: integrand(mu(g)) * eta**2 * g / mu(g), [ZERO, ONE])
            return _TBAR[key]
        cuts = sorted(cuts)
        _TBAR[key] = mp.quad(integrand, cuts)
    return _TBAR[key]


def stack(theta, indices):
    """(R_s, R_p) of flat layers without interference; indices from above down, the last may absorb."""
    sin = indices[0].real * mp.sin(theta)
    cos = lambda n: mp.sqrt(1 - (sin / n) ** 2)
    found = []
    for pol in (0, 1):
        below = ZERO
        last = len(indices) - 1
        for j in range(last):
            if sin >= indices[j + 1].real and indices[j + 1].imag == 0:
                last = j + 1
                break
        for j in reversed(range(last)):
            n, beyond = indices[j].real, indices[j + 1]
            rel = beyond / n
            down = fresnel(cos(n), rel.real, rel.imag)[pol]
            if beyond.imag != 0 or sin >= beyond.real:
                below = down
                continue
            up = fresnel(cos(beyond.real), n / beyond.real, ZERO)[pol]
            below = down + (1 - down) * (1 - up) * below / (1 - up * below)
        found.append(below)
    return found


def visibility(theta_r_deg, a_i_deg, a_o_deg):
    def g(a):
        psi = mp.radians(a - theta_r_deg)
        if mp.cos(psi) <= 0:
            return ZERO
        return max(ZERO, 1 - mp.tan(mp.radians(theta_r_deg)) * max(ZERO, mp.tan(psi)))

    return min(g(a_i_deg), g(a_o_deg))


def condition(f, inputs):
    """Sum of |x df/dx / f|, by central differences far below rounding of doubles."""
    value = f(*inputs)
    if value == 0:
        return ZERO
    total = ZERO
    for j, x in enumerate(inputs):
        if x == 0:
            continue
        step = abs(x) * mpf(10) ** -28
        up, down = list(inputs), list(inputs)
        up[j], down[j] = x + step, x - step
        total += abs(x * (f(*up) - f(*down)) / (2 * step) / value)
    return total


THETA_L = math.radians(10.0)
NAMES = "theta_i phi_i theta_o phi_o theta_r alpha_u alpha_v rho_d eta k".split()
RIGHT = math.pi / 2


def optical_cases():
    """(case, the ten inputs) for the printed BRDF and the sawtooth."""
    base = dict(theta_i=0.3, phi_i=1.2, theta_o=0.35, phi_o=-1.1, theta_r=0.17, alpha_u=0.1, alpha_v=0.1,
                rho_d=0.4, eta=1.5, k=0.0)
    metal = dict(rho_d=0.0, eta=2.9, k=3.1)

    def case(name, **changes):
        row = dict(base)
        row.update(changes)
        return name, [float(row[n]) for n in NAMES]

    def mirror(theta_r, off):
        # Both directions in the n-v plane about the facet's normal, `off` lobe slopes away from it.
        away = 0.1
        return dict(theta_i=theta_r + off + away, phi_i=RIGHT, theta_o=theta_r + off - away, phi_o=RIGHT)

    rows = []
    for alpha in (1e-6, 1e-5, 1e-4, 1e-3, 0.01, 1.0, 10.0, 1e3):
        name = f"lobe of alpha {alpha:g}"
        shape = dict(alpha_u=alpha, alpha_v=alpha, theta_r=0.17)
        rows.append(case(name + ", at the peak", **shape, **mirror(0.17, 0.0)))
        rows.append(case(name + ", one slope off", **shape, **mirror(0.17, min(alpha, 0.3))))
        rows.append(case(name + ", metal", **{**shape, **metal}, **mirror(0.17, 0.5 * min(alpha, 0.3))))
    for ratio in (1e2, 1e4, 1e6):
        rows.append(case(f"alpha_u over alpha_v {ratio:g}", alpha_u=1e-3 * ratio, alpha_v=1e-3, **mirror(0.17, 1e-3)))
        rows.append(case(f"alpha_v over alpha_u {ratio:g}", alpha_v=1e-3 * ratio, alpha_u=1e-3, **mirror(0.17, 1e-3)))
    for gap in (1e-3, 1e-6, 1e-9, 1e-12):
        name = f"{gap:g} rad above the horizon"
        rows.append(case("lamp " + name, theta_i=RIGHT - gap, phi_i=1.4))
        rows.append(case("lamp " + name + ", behind the ridges", theta_i=RIGHT - gap, phi_i=-1.4, theta_r=0.0))
        rows.append(case("camera " + name, theta_o=RIGHT - gap, phi_o=1.4))
        rows.append(case("opposite, both " + name, theta_i=RIGHT - gap, phi_i=1.4, theta_o=RIGHT - gap,
                         phi_o=1.4 - math.pi, theta_r=0.0, alpha_u=0.3, alpha_v=0.3))
        rows.append(case("side by side, both " + name, theta_i=RIGHT - gap, phi_i=1.4, theta_o=RIGHT - gap,
                         phi_o=1.3, alpha_u=10.0, alpha_v=10.0))
    for degrees in (0.0, 1e-6, 45.0, 80.0, 89.0, 89.99):
        theta_r = math.radians(degrees)
        rows.append(case(f"theta_r {degrees:g} deg", theta_r=theta_r, alpha_u=0.3, alpha_v=0.3,
                         theta_i=0.9, phi_i=1.5, theta_o=0.8, phi_o=1.6))
        rows.append(case(f"theta_r {degrees:g} deg, metal", **{**metal, "theta_r": theta_r, "alpha_u": 0.3, "alpha_v": 0.3,
                         "theta_i": 0.9, "phi_i": 1.5, "theta_o": 0.8, "phi_o": 1.6}))
    for eta, label in ((1.0, "1 exactly"), (1.0 + 1e-12, "1 + 1e-12"), (1.0 + 1e-6, "1 + 1e-6"), (5.0, "5")):
        rows.append(case(f"index {label}", eta=eta))
        rows.append(case(f"index {label}, no diffuse light", eta=eta, rho_d=0.0))
    for k in (1e-12, 1e-3, 30.0):
        rows.append(case(f"absorption {k:g}", rho_d=0.0, eta=1.5, k=k))
    for rho in (0.0, 1.0):
        rows.append(case(f"rho_d {rho:g}", rho_d=rho))
    return rows


def table(name, columns, rows):
    path = ROOT / "extreme" / f"{name}.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)
    print(f"{path}: {len(rows)} rows")


def text(x):
    return mp.nstr(x, 25)


def write():
    optical = optical_cases()
    rows = {"brdf": [], "sawtooth": []}
    for name, inputs in optical:
        exact = [mpf(x) for x in inputs]
        for form, f in (("brdf", brdf), ("sawtooth", sawtooth)):
            value = f(*exact)
            cond = condition(f, exact)
            rows[form].append([name, *map(repr, inputs), text(value), mp.nstr(cond, 4)])
    for form, found in rows.items():
        table(form, ["case", *NAMES, "value", "cond"], found)

    found = []
    for eta, k in ((1.0, 0.0), (1.0 + 1e-12, 0.0), (1.0 - 1e-12, 0.0), (1.5, 0.0), (1 / 1.5, 0.0), (1.5, 30.0), (1e-3, 30.0),
                   (2.9, 3.1), (1.0, 1e-12), (1e6, 0.0), (1e6, 1e6)):
        for cos in (1.0, 0.5, 1e-3, 1e-6, 1e-12, 1e-15):
            exact = [mpf(cos), mpf(eta), mpf(k)]
            for pol in (0, 1):
                value = fresnel(*exact)[pol]
                cond = condition(lambda c, e, q: fresnel(c, e, q)[pol], exact)
                found.append([f"{'sp'[pol]}, index {eta!r} + {k!r}i, cos {cos!r}", "sp"[pol], repr(cos), repr(eta), repr(k), text(value), mp.nstr(cond, 4)])
    table("fresnel", ["case", "polarisation", "cos", "eta", "k", "value", "cond"], found)

    found = []
    layers = {
        "20 layers, growing": [1.0 + 0.05 * j for j in range(21)],
        "20 layers, alternating": [1.0] + [1.4 if j % 2 else 2.2 for j in range(20)],
        "20 layers of one index": [1.0] + [1.5] * 20,
        "20 layers of index 1 + 1e-12": [1.0 + 1e-12 * j for j in range(21)],
        "20 layers over a metal": [1.0] + [1.3 if j % 2 else 1.7 for j in range(19)] + [0.3504 + 2.7141j],
        "20 layers over k = 30": [1.0] + [1.3 if j % 2 else 1.7 for j in range(19)] + [1.5 + 30j],
        "30 layers, growing": [1.0 + 0.03 * j for j in range(31)],
        "30 layers, alternating": [1.0] + [1.3 if j % 2 else 1.7 for j in range(30)],
        "30 layers over a metal": [1.0] + [1.3 if j % 2 else 1.7 for j in range(29)] + [0.3504 + 2.7141j],
    }
    for name, indices in layers.items():
        for degrees in (0.0, 45.0, 80.0, 89.999999):
            theta = mpf(math.radians(degrees))
            exact = [mpc(n) for n in indices]
            flat = [theta] + [part for n in exact for part in (n.real, n.imag)]

            def of(pol):
                def f(angle, *parts):
                    return stack(angle, [mpc(a, b) for a, b in zip(parts[0::2], parts[1::2])])[pol]
                return f

            value = stack(theta, exact)
            cond = [condition(of(pol), flat) for pol in (0, 1)]
            spelt = "/".join(repr(n.real) if n.imag == 0 else f"{n.real!r}+{n.imag!r}i" for n in map(complex, indices))
            found.append([f"{name} at {degrees!r} deg", spelt, repr(float(theta)), text(value[0]), mp.nstr(cond[0], 4), text(value[1]), mp.nstr(cond[1], 4)])
    table("stack", ["case", "indices", "theta", "rs", "rs_cond", "rp", "rp_cond"], found)

    found = []
    for theta_r in (0.0, 1e-6, 20.0, 60.0, 89.99):
        for pair in ((0.0, 0.0), (30.0, 60.0), (theta_r, theta_r), (89.999999, 0.0), (-40.0, -89.999999), (theta_r + 0.005, theta_r)):
            exact = [mpf(theta_r), mpf(pair[0]), mpf(pair[1])]
            value = visibility(*exact)
            found.append([f"theta_r {theta_r!r} deg, lamp {pair[0]!r}, camera {pair[1]!r}", repr(theta_r), repr(pair[0]), repr(pair[1]), text(value), mp.nstr(condition(visibility, exact), 4)])
    table("visibility", ["case", "theta_r_deg", "theta_i_proj_deg", "theta_o_proj_deg", "value", "cond"], found)


def check():
    worst = 0
    with (ROOT / "brdf" / "reference.csv").open() as file:
        for n, row in enumerate(csv.DictReader(file)):
            if n % 30 == 0:
                value, want = brdf(*[mpf(float(row[x])) for x in NAMES]), mpf(row["f"])
                if want:
                    worst = max(worst, abs(value / want - 1))
    print("brdf/reference.csv: largest relative difference", mp.nstr(worst, 3))
    worst, peak = 0, 0
    with (ROOT / "sawtooth-closed-form.csv").open() as file:
        for n, row in enumerate(csv.DictReader(file)):
            x = {key: mpf(float(v)) for key, v in row.items()}
            peak = max(peak, x["radiance"])
            if n % 5:
                continue
            rad = mp.radians
            tc, tl, ps = rad(x["theta_c_deg"]), rad(x["theta_l_deg"]), rad(x["phi_s_deg"])
            rig = lambda t: [mp.sin(t), ZERO, mp.cos(t)]
            turn = lambda w: [w[0] * mp.sin(ps), w[0] * mp.cos(ps), w[2]]
            value = sawtooth_of(turn(rig(tc + tl)), turn(rig(tc)), rad(x["theta_r_deg"]), x["alpha_u"], x["alpha_v"], x["rho_d"],
                                x["eta"], x["k"], tl, rad(x["light_radius_deg"]), x["amplitude"])
            worst = max(worst, abs(value - x["radiance"]))
    print("sawtooth-closed-form.csv: largest difference over the peak", mp.nstr(worst / peak, 3))


if __name__ == "__main__":
    check() if "--check" in sys.argv else write()
