"""Example: compute the results of a study from the tables of `rig session analyse`, with pandas and statsmodels alone.

    rig session analyse sessions/study --output out
    python from_tables.py out

For the limits of stiffness by the search rule, this program computes means over participants, paired differences with
Holm's correction, a mixed model, and Cohen's kappa. Unlike the analysis itself, it does not handle limits beyond the
tested levels, too few participants, and covariates that cannot be separated from the conditions.
"""

import json
import sys
from itertools import combinations
from pathlib import Path

import pandas as pd
from statsmodels.formula.api import mixedlm
from statsmodels.stats.inter_rater import cohens_kappa
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.weightstats import DescrStatsW


def read(directory: Path, name: str) -> pd.DataFrame:
    """Return a table of the analysis as a data frame, with the unit removed from the end of each column's name."""
    dictionary = json.loads((directory / "tables.json").read_text(encoding="utf-8"))
    table = pd.read_parquet(directory / f"{name}.parquet")
    for column, column_facts in dictionary["tables"][name]["columns"].items():
        unit = column_facts["unit"].lower().replace("·", "_").replace("/", "_per_").replace("²", "2")
        table = table.rename(columns={column: column.removesuffix(f"_{unit}")})
    return table


def limits(directory: Path) -> pd.DataFrame:
    """Return the stiffness limit K_max of each participant in each condition at each damping (mean over repeats)."""
    runs = read(directory, "runs")
    runs = runs[(runs["state"] == "complete") & runs["limit_rule"].notna() & (runs["limit_rule_mark"] == "")]
    by = ["participant", "condition", "damping"]
    return runs.groupby(by, as_index=False)[["limit_rule", "order", "block"]].mean()


def over_participants(kmax: pd.DataFrame) -> pd.DataFrame:
    """Return mean of K_max and its 95 % confidence interval (Student's t) for each condition at each damping."""
    rows = []
    for (condition, damping), of in kmax.groupby(["condition", "damping"]):
        values = DescrStatsW(of["limit_rule"])
        low, high = values.tconfint_mean()
        rows.append((condition, damping, len(of), values.mean, low, high))
    return pd.DataFrame(rows, columns=["condition", "damping", "participants", "kmax", "low", "high"])


def differences(kmax: pd.DataFrame, conditions: list[str]) -> pd.DataFrame:
    """Return the paired difference of K_max for each two conditions at each damping, with 95 % interval and p value.

    With several dampings, rows whose damping is empty contain the difference of the mean over all dampings.
    """
    wide = kmax.pivot(index="participant", columns=["condition", "damping"], values="limit_rule")
    dampings = sorted(kmax["damping"].unique())
    rows = []
    for damping in [*dampings, None] if len(dampings) > 1 else dampings:
        for against, condition in combinations(conditions, 2):
            of = [damping] if damping is not None else dampings
            less = (wide[condition][of] - wide[against][of]).mean(axis=1, skipna=False).dropna()
            values = DescrStatsW(less)
            p = values.ttest_mean(0.0)[1]
            rows.append((condition, against, damping, values.mean, *values.tconfint_mean(), p))
    table = pd.DataFrame(rows, columns=["condition", "against", "damping", "difference", "low", "high", "p"])
    return table.assign(p_holm=multipletests(table["p"], method="holm")[1])


def mixed_model(kmax: pd.DataFrame) -> object:
    """Return the fitted mixed model of K_max over condition and damping, with random effects of participants."""
    frame = kmax.assign(damping=kmax["damping"].map("B = {:g}".format))
    several = [name for name in ("condition", "damping") if frame[name].nunique() > 1]
    random = {f"participant × {name}": f"0 + C({name})" for name in several} if len(several) > 1 else {}
    covariates = [name for name in ("order", "block") if frame[name].nunique() > 1]
    formula = "limit_rule ~ " + " + ".join([" * ".join(several), *covariates])
    model = mixedlm(formula, frame, groups="participant", re_formula="1", vc_formula=random or None)
    return model.fit(method=["bfgs", "lbfgs", "powell"])


def kappa(directory: Path) -> float:
    """Return Cohen's kappa of the person's and the automatic verdicts (stable or not stable) over all trials."""
    table = read(directory, "agreement")
    of = table[(table["table"] == "two classes") & (table["condition"] == "")]
    counts = of.pivot(index="person", columns="automatic", values="trials")
    return float(cohens_kappa(counts.loc[counts.columns].to_numpy()).kappa)


def main(directory: Path) -> None:
    """Read the tables of an analysis from a directory and print the results."""
    kmax = limits(directory)
    print(over_participants(kmax).to_string(index=False), end="\n\n")
    print(
        differences(kmax, list(read(directory, "kmax_over_participants")["condition"].unique())).to_string(
            index=False
        ),
        end="\n\n",
    )
    print(mixed_model(kmax).summary(), end="\n\n")  # type: ignore[attr-defined]
    print(f"kappa {kappa(directory):.3f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
