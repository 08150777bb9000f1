"""Predict Vs of samples from features of your own, and test the predictions on samples that were left out.

    python examples/own_predictor.py CAMPAIGN.db PERCENT

ln Vs of a content is a linear function of the features. Each sample is predicted from all others; its error is its
residual in the full fit over one minus its leverage (Allen 1974). A feature is useful if its error is smaller than that
of the content alone. `campaign.predict` uses the shares of cemented contacts at the receiver's height and of all.
"""

import argparse
import sys

import numpy as np

import calcidem


def own_features(campaign: calcidem.Campaign, seed: int, content: float) -> list[float]:
    """Change this: numbers known before a sample is simulated; here shares of contacts with P and with C cement."""
    kind = campaign.sample(seed=seed, content=content).kind  # of each contact: 0 none, 1 P, 2 C
    return [float(np.mean(kind == 1)), float(np.mean(kind == 2))]


def left_out_errors(features: np.ndarray, vs: np.ndarray) -> np.ndarray:
    """Errors (n,) of ln Vs of samples with features (n, k) that are left out one by one."""
    design = np.column_stack([np.ones(len(vs)), features - features.mean(axis=0)])
    inverse = np.linalg.pinv(design, rcond=1e-9)  # features may depend on one another
    leverage = np.einsum("ik,ki->i", design, inverse)
    return (np.log(vs) - design @ (inverse @ np.log(vs))) / (1.0 - leverage)


def main() -> None:
    """Print the errors with each set of features."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("database")
    parser.add_argument("content", type=float, help="percent")
    options = parser.parse_args()
    content = options.content
    with calcidem.open_campaign(options.database) as campaign:
        known = [c for c in campaign.vs().content.values.tolist() if c > 0.0]  # without cement there is one sample
        if content not in known:
            sys.exit(f"content = {content:g} %: give one of {', '.join(f'{c:g}' for c in known)}")
        vs = campaign.vs().sel(content=content).dropna("seed")
        own = np.array([own_features(campaign, seed, content) for seed in vs.seed.values.tolist()])
        names = ["path_normalized_connectivity", "path_bonded_fraction"]
        path = campaign.to_dataframe(names, content=content, status="done").to_numpy(dtype=float)
    for name, features in {
        "content alone": own[:, :0],
        "own": own,
        "path": path,
        "both": np.hstack([own, path]),
    }.items():
        errors = left_out_errors(features, vs.to_numpy())
        print(f"{name}: rms error of Vs {100.0 * np.sqrt(np.mean(errors**2)):.1f} % of {errors.size} samples")


if __name__ == "__main__":
    main()
