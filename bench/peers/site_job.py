#!/usr/bin/env python3
"""Analysis of one site with the functions of field_baseline.py, and nothing of its scoring: speed, axle times, ballast by the quasi-static fit and
by evidence, forces of all passages twice (before and after registering them), irregularity.
usage: site_job.py SITE_DIR      prints one line of JSON"""
import contextlib, io, json, sys
import numpy as np, field_baseline as b

with contextlib.redirect_stdout(io.StringIO()):
    site = b.Site(sys.argv[1]); n = site.n; sen = site.c["sensor"]
    v = np.array([b.speed_from_stack(site, p["acc"]) for p in site.p]); fq = np.arange(.5, 30, .5)
    Hc, Hs, _ = site.track.receptance(fq, np.full(site.track.ns, site.c["ballast"]["stiffness_n_m2"]))
    t0 = np.array([b.time_from_qs(site, b.integrate(site.p[i]["acc"], site.fs, sen, 1.0), v[i], site.Q(i), Hc + Hs, fq, 1.0) for i in range(n)])
    A = [b.reconstruct(site.p[i]["acc"], site.fs, sen, t0[i] + site.off/v[i], v[i]) for i in range(n)]
    th, ts, _ = b.Calib(site, [a[0] for a in A], v, [max(1.0, a[1]) for a in A], range(n)).run(); tc = np.array([ts[i] for i in range(n)])
    hy = b.choose_hyper(site, th, v, tc, [0, 8, 16]); the, te, *_ = b.evidence_calibrate(site, v, tc, hy, range(0, n, 4))
    kb = b.ballast(site.track, the); hj = hy[:4] + (0.08,)
    _, keep, _ = b.run_joint(site, None, kb, v, te, hj); tr = b.register(site, keep, v, te)
    _, keep, _ = b.run_joint(site, None, kb, v, tr, hj)
    irr = b.irregularity(site, kb, keep, v, range(0, n, 6))
    E = [b.score(np.array([b.truth_lp(site, i, "c", w, site.truth[i]["v"], x*site.sgn/site.truth[i]["v"]) for w in range(len(F))]), F, x) for i, (_, x, F) in keep.items()]
    peak, nrmse = np.concatenate([abs(e[0]) for e in E]), np.concatenate([e[1] for e in E])
print(json.dumps(dict(ballast_mn_m2=[round(float(q), 3) for q in (the[0]*1e-6, the[1]*1e-6, the[2])], peak_error=float(np.median(peak)),
                      peak_p90=float(np.percentile(peak, 90)), waveform=float(np.median(nrmse)), irregularity=float(irr[0])/100)))
