"""Simulated campaigns by an arm that shares no code with the model: `python benchmarks/calibration_campaigns.py [n]`.

coverage: nominal 90 % intervals where only modelled errors exist; outliers: how far 5 % gross errors move the parameters;
arms: held-out error of arms with gear ripple and backlash that no model has, beside an oracle that knows the arm.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from robots.calibration.fit import fit_campaign, learned_priors, predict_readings
from robots.calibration.layout import Priors
from robots.calibration.solver import Campaign
from tests.support.simulated_campaign import EXTRA, INSTRUMENT, PAYLOADS, campaign_readings, measured, random_truth

READINGS = 50


def coverage_and_outliers(count: int) -> None:
    inside, predicted, moves = [], [], []
    priors = Priors(3e-4, 3e-4)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        truth = random_truth(rng)
        readings = measured(truth, campaign_readings(rng, READINGS), rng)
        campaign = Campaign(EXTRA, readings, PAYLOADS, INSTRUMENT)
        fit = fit_campaign(campaign, priors=priors)
        true = np.concatenate([truth.robot.mdh.ravel(), truth.compliance])
        active = fit.layout.arm >= 0
        inside.append(np.abs(fit.state.arm - true)[active] < 1.645 * fit.sd[fit.layout.arm[active]])
        fresh = campaign_readings(rng, 60)
        points, covariance = predict_readings(fit, fresh)
        sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        predicted.append(np.abs(points - truth.points(fresh)) < 1.645 * sd)
        gross = rng.random(READINGS) < 0.05
        point = readings.point + gross[:, None] * rng.normal(size=(READINGS, 3)) * 3e-3
        other = fit_campaign(replace(campaign, readings=replace(readings, point=point)), priors=priors)
        arm = fit.layout.arm[active]
        moves.append((other.offset - fit.offset)[arm] / fit.sd[arm])
    move = np.abs(moves)
    print(f"| 90 % intervals of the arm's parameters cover | {np.mean(inside):.1%} |")
    print(f"| 90 % intervals of fresh points cover | {np.mean(predicted):.1%} |")
    print(f"| 5 % outliers of 3 mm move a parameter, rms | {np.sqrt(np.mean(move**2)):.2f} sd |")
    print(f"| moved by at most one sd | {np.mean(move <= 1):.1%} |", flush=True)


def arms(count: int) -> None:
    ours, oracle, before = [], [], []
    for seed in range(count):
        rng = np.random.default_rng(1000 + seed)
        truth = random_truth(rng, background=2e-5)
        readings = measured(truth, campaign_readings(rng, READINGS), rng)
        campaign = Campaign(EXTRA, readings, PAYLOADS, INSTRUMENT)
        first = fit_campaign(campaign)
        fit = fit_campaign(campaign, priors=learned_priors(first), begin=first.state)
        fresh = campaign_readings(rng, 100)
        wanted = truth.points(fresh)
        ours.append(np.linalg.norm(predict_readings(fit, fresh)[0] - wanted, axis=1).mean())
        smooth = replace(truth, ripple=np.zeros((6, 3)), backlash=np.zeros(6))
        oracle.append(np.linalg.norm(smooth.points(fresh) - wanted, axis=1).mean())
        nominal = replace(smooth, robot=EXTRA)
        before.append(np.linalg.norm(nominal.points(fresh) - wanted, axis=1).mean())
    print(f"| {count} arms with ripple and backlash, mean error of fresh points, mm | {1e3 * np.mean(ours):.4f} |")
    print(f"| the worst of these arms | {1e3 * np.max(ours):.4f} |")
    print(f"| an oracle that knows the arm but for ripple and backlash | {1e3 * np.mean(oracle):.4f} |")
    print(f"| the nominal arm at the true place of the tracker | {1e3 * np.mean(before):.3f} |", flush=True)


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    coverage_and_outliers(number)
    arms(max(number // 2, 1))
