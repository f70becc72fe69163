"""The index, slowly and plainly, from the tables: scalars, no arrays, no sharing with the room's own functions."""

from __future__ import annotations

import math


def stop_terms(age, omega, a=8.0, brake=0.06, watch=0.15, reaction=0.06):
    """(T_r, T_s, braking travel per m/s)."""
    return max(age, watch) + reaction, brake + omega / a, brake + omega / a / 2


def person(d, d_nom, v, harm, *, age, omega, c=0.10):
    if v == 0:
        return 0.0
    t_r, t_s, t_b = stop_terms(age, omega)
    hit = v * t_r + v * t_b
    s_p = 1.6 * (t_r + t_s) + hit + c
    if d >= s_p + 0.30:
        return 1.0
    if d >= s_p:
        return 1 + (s_p + 0.30 - d) / 0.30
    if d > hit:
        return 2 + (s_p - d) / (s_p - hit)
    blow = min(1.0, (hit - d) / hit) * max(0.0, v / harm - 1)
    return 3 + min(1.0, max(blow, max(0.0, -d_nom) / 0.05))


def thing(d, v, band, *, omega):
    if v == 0:
        return 0.0
    hit = v * stop_terms(0, omega)[2]
    if d >= hit + band:
        return 1.0
    if d > hit:
        return 1 + (hit + band - d) / band
    return 2 + min(1.0, (hit - d) / hit)


def zone(d, v, tier, *, omega):
    hit = v * stop_terms(0, omega)[2]
    return 0.0 if v == 0 else 1 + (tier - 1) * min(1.0, max(0.0, (hit + 0.02 - d) / 0.02))


LIMITS = {  # force N, spring N/mm, body kg, transient, threshold of harm
    "head": (65, 75, 4.4, 1, 1),
    "neck": (150, 50, 1.2, 2, 1),
    "torso": (140, 25, 40, 2, 2),
    "abdomen": (110, 10, 40, 2, 2),
    "pelvis": (180, 25, 40, 2, 2),
    "upper_arm": (150, 30, 3, 2, 2),
    "lower_arm": (160, 40, 2, 2, 2),
    "hand": (140, 75, 0.6, 2, 2),
    "thigh": (220, 50, 75, 2, 2),
    "shin": (130, 60, 75, 2, 2),
}


def harm_speed(region, mass):
    force, spring, body, transient, phi4 = LIMITS[region]
    return phi4 * transient * force / math.sqrt(spring * 1000 / (1 / body + 1 / mass))
