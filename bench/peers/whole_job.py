#!/usr/bin/env python3
"""The job of one crossing with the functions of numpy_cpcm.py, and nothing else of it: ballast from ten passages, forces of all passages with
kernels of each passage's own speed, rail deflection and irregularity of all of them. Same displacements as `cpcm bench` uses.
usage: whole_job.py PASSAGES.parquet      prints one line of JSON"""
import json, os, sys
path = os.path.abspath(sys.argv[1]); sys.argv = ["x", "soft"]
import numpy as np, pyarrow.parquet as pq, numpy_cpcm as c
from scipy.optimize import least_squares

p = c.P; fs, v, Q = p["fs"], p["v"], p["axle_load"] / 2
t = pq.read_table(path); D = np.array(t["displacement_m"].to_pylist()).T; F = np.array(t["contact_force_n"].to_pylist()).T; n = D.shape[1]
tr = c.Track(p); nn = tr.nn; nb = int(round(p["bogie"] / (v / fs)))

# ballast: low-passed mean of ten passages against a constant load, as in numpy_cpcm.py, (g), "LP on both"
def kbdist(th):
    kb = np.full(p["n_sleepers"], th[0]*1e6); m = p["n_sleepers"]//2; u = np.abs(np.arange(-2, 3))/2.0
    kb[m-2:m+3] = 1e6*(th[1] + (th[0]-th[1])*u**2*th[2] + (th[0]-th[1])*u*(1-th[2])); return kb
fc_s = 1000.0; fc = np.fft.rfftfreq(int(p["nfft"]*fc_s/fs), 1/fc_s); flp = v/2.3; sel = slice(150, 400)
measured = c.brick(D[:, :10], fs, hi=flp)[::5].mean(1)
def res(th):
    tr.set_ballast(kbdist(th)); g = c.irf(tr.receptance(fc, [tr.S])[:, :, 0], fc_s)
    y = (c.kernel_fr(g[:, :nn], tr.x, v, fc_s) + c.kernel_fr(g[:, nn:2*nn], tr.x, v, fc_s)).sum(1)*Q; m = int(round(p["bogie"]/(v/fc_s)))
    r = y.copy(); r[m:] += y[:-m]; k = min(len(r), len(measured)); out = np.zeros(len(measured)); out[:k] = r[:k]
    return 1e3*(c.brick(out, fc_s, hi=flp) - measured)[sel]
o = least_squares(res, [40., 30., .5], bounds=([1, .1, 0], [200, 200, 1]), x_scale=[30, 30, 1], diff_step=1e-3); tr.set_ballast(kbdist(o.x))

# forces: tolerance sweep of the paper for f - Q, kernels and singular values of every passage (bench_min.py, e')
f = np.fft.rfftfreq(p["nfft"], 1/fs); g = c.irf(tr.receptance(f, [tr.S])[:, :, 0], fs); tols = np.logspace(-1, -10, 46); lp = lambda y: c.brick(y, fs, hi=250)
peak, nrmse, forces = [], [], np.full(F.shape, Q)
for j in range(n):
    a, b = c.kernel_fr(g[:, :nn], tr.x, v, fs), c.kernel_fr(g[:, nn:2*nn], tr.x, v, fs); N = len(a); i1, i2 = (int(round(q/(v/fs))) for q in p["tr"])
    k = (a + b).sum(1)*Q; y = (D[:, j] - k - np.r_[np.zeros(nb), k[:-nb]])[i1:i2]; A = a[i1:i2, i1:i2]; U, s, Vt = np.linalg.svd(A); best = (np.inf, None)
    for tol in tols:
        r = int((s > tol*s[0]).sum()); ft = lp(np.r_[np.zeros(i1), Vt[:r].T @ ((U[:, :r].T @ y)/s[:r]), np.zeros(N - i2)])[i1:i2]; q = np.linalg.norm(A @ ft - y)
        if q < best[0]: best = (q, ft)
    forces[i1:i2, j] += best[1]; true, found = lp(F[:, j])[i1:i2], Q + best[1]
    peak.append(abs(found.max()/true.max() - 1)); nrmse.append(np.sqrt(((found - true)**2).mean())/np.ptp(true))

# rail deflection under the wheel and irregularity (f1, f2, f3, f4)
Gm = c.kernel_mr(c.irf(tr.receptance(f, 2*np.arange(nn))[:, :nn], fs)[:N], tr.x, v, fs); rd = Gm @ forces
w = np.fft.rfft((Q - forces)/(p["m_wheelset"]/2), axis=0); fr = np.fft.rfftfreq(N, 1/fs); w[1:] /= -(2*np.pi*fr[1:, None])**2; w[0] = 0
irr = c.brick(np.fft.irfft(w, n=N, axis=0) - rd, fs, lo=v, hi=250)
print(json.dumps(dict(ballast_mn_m2=o.x.round(3).tolist(), peak_error=float(np.median(peak)), waveform_error=float(np.median(nrmse)),
                      deflection_mm=float(1e3*rd.max()), irregularity_rms_mm=float(1e3*irr[i1:i2].std()))))
