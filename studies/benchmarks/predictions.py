"""What does a prediction of each kind of record cost, with slopes along twelve numbers? Of a linear model, whose
waveform is not sampled, and of the same with a cubic spring and a curved pick-off of strength zero beside it, in one
run.

The records are those of the package's demo, or of a case of yours. The last column is the largest difference of the
two, in standard deviations of the noise.
"""

import argparse
import json
import os
import time
from dataclasses import replace
from pathlib import Path

from memsgyro_jax.base import runtime


def timed(function, repeat: int) -> tuple[float, float]:
    """Seconds that a first call takes more than a later one, and the fastest later one."""
    import jax

    spent = []
    for _ in range(1 + repeat):
        began = time.perf_counter()
        jax.block_until_ready(function())
        spent.append(time.perf_counter() - began)
    return spent[0] - min(spent[1:]), min(spent[1:])


def rows(folder: str | None, repeat: int) -> list[dict]:
    """A row for each kind of experiment."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    import memsgyro_jax as mg
    from memsgyro_jax.base.transforms import from_vector
    from memsgyro_jax.diagnosis.joint_residual import Joint
    from memsgyro_jax.diagnosis.linearised import WIDTH
    from memsgyro_jax.measurement.linear_start import starting_device
    from memsgyro_jax.measurement.readings import model_of, readings_of

    case = mg.load_case(Path(mg.__file__).parent / "demo" if folder is None else folder)
    model = model_of(case, starting_device(case))
    absent = [mg.effects.by_name("cubic_stiffness", "x"), mg.effects.by_name("pickoff_nonlinearity", "x")]
    found = []
    for readings in {type(r.experiment): r for r in readings_of(case)}.values():
        row, values = {"kind": type(readings.experiment).__name__, "rows": len(readings.record)}, {}
        for name, one in (("linear", model), ("sampled", model.with_effect(*absent))):
            joint = Joint(one, [readings if readings.fitted else replace(readings, fitted=True)])
            at, ways = jnp.asarray(joint.start), jnp.eye(WIDTH, joint.start.size)

            @jax.jit
            def both(vector, joint=joint, experiment=readings.experiment, ways=ways):
                def residual(vector):
                    return experiment.residual(from_vector(vector, joint.model, joint.spec))

                along = jax.vmap(lambda way: jax.jvp(residual, (vector,), (way,)), out_axes=(None, 0))
                return along(ways)

            row[f"compile_{name}_s"], row[f"{name}_s"] = timed(lambda both=both, at=at: both(at), repeat)
            values[name] = np.asarray(both(at)[0])
        row["apart"] = float(np.nanmax(np.abs(values["linear"] - values["sampled"])))
        found.append(row | {"ratio": row["sampled_s"] / row["linear_s"]})
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", help="a folder with a measurement case; the demo where none is given")
    parser.add_argument("--repeat", type=int, default=7, help="timed calls; the fastest counts")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "out" / "predictions")
    options = parser.parse_args()
    runtime.configure(devices=1)
    load = os.getloadavg()[0]
    found = rows(options.case, options.repeat)
    print(f"load of the machine before: {load:.1f}")
    print("kind             rows   linear  sampled  ratio  compile linear  sampled    apart")
    for one in found:
        print(f"{one['kind']:15s} {one['rows']:5d} {one['linear_s']:7.4f}s {one['sampled_s']:7.4f}s "
              f"{one['ratio']:6.1f} {one['compile_linear_s']:14.1f}s {one['compile_sampled_s']:7.1f}s "
              f"{one['apart']:8.1e}")  # fmt: skip
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "predictions.json").write_text(json.dumps({"load_before": load, "kinds": found}, indent=1))


if __name__ == "__main__":
    main()
