"""How fast are sweeps of PLL, gain control and force rebalance, beside the default loop? One process, turn by turn.

    python studies/benchmarks/classic.py

Each loop's `sweep` runs once to compile, then all take turns; the fastest turn of each counts, by processor time.
"""

import argparse
import time

from memsgyro_jax.base import runtime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dies", type=int, default=256)
    parser.add_argument("--duration", type=float, default=0.1, help="of each die's run, in s")
    parser.add_argument("--repeat", type=int, default=5)
    options = parser.parse_args()
    runtime.configure(devices=1)
    import equinox as eqx
    import jax

    import memsgyro_jax as mg

    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()

    def classic(make, product=False) -> mg.ClosedLoop:
        control = make(gyro, readout, amplitude=1e-6)
        if product:
            where = lambda c: (c.drive.demodulator, c.sense.demodulator)  # noqa: E731
            made = tuple(mg.ProductDemodulator(each.bandwidth) for each in where(control))
            control = eqx.tree_at(where, control, made)
        return mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), control, (0.0,) * 4)

    open_loop, rebalance = mg.ClassicControl.open_loop, mg.ClassicControl.force_rebalance
    loops = {
        "default (Kalman filter)": mg.Operation.of(gyro, readout).loop(),
        "PLL, AGC, open sense": classic(open_loop),
        "PLL, AGC, open sense, products": classic(open_loop, product=True),
        "PLL, AGC, rebalanced": classic(rebalance),
        "PLL, AGC, rebalanced, products": classic(rebalance, product=True),
    }
    first, best = {}, dict.fromkeys(loops, float("inf"))
    for turn in range(1 + options.repeat):
        for name, loop in loops.items():
            began, used = time.perf_counter(), time.process_time()
            mg.sweep(loop, mg.Spread.relative(0.15), 1.0, dies=options.dies, duration=options.duration, bound_dies=0)
            if turn:
                best[name] = min(best[name], time.process_time() - used)
            else:
                first[name] = time.perf_counter() - began
    print(f"{options.dies} dies of {options.duration:g} s at 100 kHz on one core of {jax.devices()[0].device_kind}")
    samples, default = options.dies * round(options.duration * 100e3), next(iter(best.values()))
    for name, spent in best.items():
        speed = f"{samples / spent / 1e6:6.2f} million samples/s, {default / spent:5.2f} x the default loop"
        print(f"  {name:<32} {speed}; first call {first[name]:.1f} s")


if __name__ == "__main__":
    main()
