"""Find a planted backlash: a tracker campaign of a robot whose joint 2 has play, and a diagnosis that was not told."""

from pathlib import Path

from ocp.api import DiagnosisResult, diagnose, simulate


def main(out: Path, poses: int = 60) -> DiagnosisResult:
    """Plant 0.3 mrad of half width in joint 2, measure `poses` postures, diagnose."""
    run = simulate(out=out / "run", effects=["backlash:2=3e-4"], poses=poses, seed=4)
    result = diagnose(run.folder, out=out / "diagnosis")
    print(result.line)
    found = result.answer.diagnosis
    for one in found.ranking[:3]:
        print(f"{one.name}: probability {one.probability:.2f}, {one.active.parameters}")
    print(f"no name: {found.p_none:.2f}; something outside the catalogue: {found.p_unknown:.2f}")
    for gap in result.answer.gaps:
        if gap.shrinkage is not None:
            print(f"{gap.name}: expected to shrink by {100 * gap.shrinkage.predicted:.0f} % {gap.there}")
    return result


if __name__ == "__main__":
    main(Path("example_4"))
