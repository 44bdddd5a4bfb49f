"""What parts from outside return in another shape is one sentence before the run, not a text about a scan."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

import memsgyro_jax as mg


GYRO = mg.SingleMassGyro.from_modes("15 ug", ("3.2 kHz", "3.26 kHz"), (400, 350))
READOUT = mg.DirectReadout(1e5, noise_density=1e-7)
RUN = {"sample_rate": 80e3, "duration": 1e-4}


class Still(mg.AbstractObserver):
    model = mg.SingleMassGyro.model

    def init(self):
        return 0.0, (1e-6, 0.0)

    def update(self, state, measured, force, clock):
        return state

    def estimate(self, state):
        return mg.Estimate((*state[1], 0.0, 0.0), GYRO.coefficients(state[0]), (0.0, 0.0), self.model)


class Silent(mg.AbstractController):
    def init(self):
        return (0.0,)

    def command(self, state, estimate, clock):
        return (0.0, 0.0), state


class Longer(Still):
    def update(self, state, measured, force, clock):
        return jnp.array(measured), state[1]


class Counts(Still):
    def init(self):
        return 0, (1e-6, 0.0)

    def update(self, state, measured, force, clock):
        return state[0] + measured[0], state[1]


class Short(Still):
    def estimate(self, state):
        return mg.Estimate((*state[1], 0.0, 0.0), GYRO.coefficients(state[0])[:3], (0.0, 0.0), self.model)


class Vectors(Silent):
    def command(self, state, estimate, clock):
        return (jnp.zeros(2), jnp.zeros(2)), state


class Forgets(Silent):
    def command(self, state, estimate, clock):
        return (0.0, 0.0), ()


class OneVolt(mg.DirectReadout):
    def measure(self, motion, noise, drift, period, effects=None, late=None):
        return self.clean(motion, drift)[0]


class Deaf(mg.DirectReadout):
    def noise_std(self, period):
        return 1e-3


class TwoRates(mg.AbstractProfile):
    def value(self, time):
        return jnp.array([time, time])


class InWords(mg.AbstractProfile):
    def value(self, time):
        return "5 deg/s"


class Branches(Silent):
    def command(self, state, estimate, clock):
        return (1e-9 if clock.time > 0.0 else 0.0, 0.0), state


class Told(Silent):
    def output(self, state, estimate):
        return estimate if state[0] > 0.0 else None


class InPython(Still):
    def update(self, state, measured, force, clock):
        return float(measured[0]), state[1]


class InNumpy(Still):
    def update(self, state, measured, force, clock):
        return np.sin(measured[0]), state[1]


class Timeless(Silent):
    def command(self, state, estimate):
        return (0.0, 0.0), state


class Third(Still):
    def update(self, state, measured, force, clock):
        return jnp.array(measured)[2], state[1]


class Plain(mg.DirectReadout):
    def measure(self, motion, noise, drift, period):
        return self.clean(motion, drift)


class Stepped(mg.AbstractProfile):
    def value(self, time):
        return 1.0 if time > 0.5 else 0.0


class Both(mg.effects.ForceEffect):
    name, unit, law = "both", "N/m", "k·x"
    strength: Array = mg.effects.strength()

    def force(self, now):
        return [self.strength * now.displacement[0], self.strength * now.displacement[1]]


class Beyond(Both):
    def force(self, now):
        return self.strength * jnp.stack([now.displacement[2], now.displacement[1]])


def carrying(effect):
    return {"device": GYRO.with_effect(effect)}


@pytest.mark.parametrize(
    ("parts", "rate", "words"),
    [
        ({"observer": Longer()}, 0.0, r"`update` of Longer .* \(float64, .* but returns \(float64 of shape \(2,\), "),
        ({"observer": Counts()}, 0.0, r"`update` of Counts .* gives, \(int64, .* begins as 0.0, not as 0\."),
        ({"observer": Short()}, 0.0, r"`estimate` of Short must return an `Estimate` whose `theta` is 8 numbers"),
        ({"controller": Vectors()}, 0.0, r"`command` of Vectors .* each force a number, but returns \(float64 of sh"),
        ({"controller": Forgets()}, 0.0, r"`command` of Forgets must return a state .* gives, \(float64\), .* \(\)\."),
        ({"readout": OneVolt(1e5)}, 0.0, r"`measure` of OneVolt must return two numbers, V .* but returns float64\."),
        ({"readout": Deaf(1e5)}, 0.0, r"`noise_std` of Deaf must return two numbers"),
        ({}, TwoRates(), r"`value` of TwoRates must return a number, but returns float64 of shape \(2,\)"),
        ({}, InWords(), r"`value` of InWords must return numbers, but returns .* of type str"),
        (
            {"controller": Branches()},
            0.0,
            r"`command` of Branches \(line \d+ .* on a number; choose with `jax.numpy.where`",
        ),
        (
            {"controller": Told()},
            0.0,
            r"`output` of Told \(line \d+ .* branches on a number; choose with `jax.numpy.whe",
        ),
        ({"observer": InPython()}, 0.0, r"`update` of InPython .* leave out `float` or `int`\."),
        ({"observer": InNumpy()}, 0.0, r"`update` of InNumpy .* call the function of that name in `jax.numpy`"),
        ({}, Stepped(), r"`value` of Stepped .* choose with `jax.numpy.where` instead of `if`\."),
        (
            {"controller": Timeless()},
            0.0,
            r"must take \(self, state, estimate, clock\), but takes \(self, state, estimate\)",
        ),
        ({"observer": Third()}, 0.0, r"`update` of Third must stay within its arrays, but reaches for entry 2 of 2"),
        (
            {"readout": Plain(1e5), **carrying(mg.effects.PickoffNonlinearity(0, 1e-3))},
            0.0,
            r"`measure` of Plain must take \(self, motion, noise, drift, period, effects\), but takes",
        ),
        (
            carrying(Both(1.0)),
            0.0,
            r"`both`: method `force` must return an array of shape \(2,\), but returns a list; ",
        ),
        (carrying(Beyond(1.0)), 0.0, r"`both`: method `force` reaches for entry 2 of 2, .* on a device of 2 axes\."),
    ],
)
@pytest.mark.parametrize("lot", [False, True])
def test_another_shape_is_one_sentence(parts, rate, words, lot):
    usual = {"device": GYRO, "readout": READOUT, "observer": Still(), "controller": Silent()}
    loop = mg.ClosedLoop(**{**usual, **parts})
    with pytest.raises(mg.InputError, match=words) as error:
        mg.sweep(loop, mg.Spread.relative(1e-3), rate, dies=2, **RUN) if lot else mg.simulate(loop, rate, **RUN)
    assert "\n" not in str(error.value)


class Pair(mg.losses.AbstractMean):
    def of(self, sample):
        return jnp.array([sample.rate, sample.rate])


class Growing(mg.losses.AbstractLoss):
    def init(self):
        return 0.0

    def sample(self, memory, sample):
        return memory, memory

    def value(self, memory):
        return memory


class Listed(Growing):
    def sample(self, memory, sample):
        return memory

    def value(self, memory):
        return jnp.stack([memory, memory])


class Larger(mg.losses.AbstractMean):
    def of(self, sample):
        return sample.rate if sample.rate > 0.0 else -sample.rate


class Nothing(mg.losses.AbstractMean):
    def of(self):
        return 0.0


@pytest.mark.parametrize(
    ("loss", "words"),
    [
        (
            Larger(),
            r"`of` of Larger \(line \d+ of its file\) must .* branches on a number; choose with `jax.numpy.where`",
        ),
        (Nothing(), r"`of` of Nothing must take \(self, sample\), but takes \(self\)"),
        (Pair(), r"`sample` of Pair must return a state .* but returns \(float64 of shape \(2,\), float64\)"),
        (Growing(), r"`sample` of Growing must return a state"),
        (Listed(), r"`value` of Listed must return a number, the loss of a die, but returns float64 of shape \(2,\)"),
    ],
)
def test_a_loss_of_another_shape_is_one_sentence(loss, words):
    loop = mg.ClosedLoop(GYRO, READOUT, Still(), Silent())
    with pytest.raises(mg.InputError, match=words):
        mg.tune(loop, 1.0, free={"start.0": (1e-7, 1e-5)}, loss=loss, dies=2, validation_dies=1, **RUN)
