"""The true device: forces in newton, every effect of the catalogue and some outside it, and the read-out."""

from functools import partial

import numpy as np
from lab.die import Hidden


class Plant:
    """Law of motion of a die with hidden effects, in the form that `flow` integrates.

    State (parts, rows): x, y, vx, vy, then what active effects remember. `mode` (switches, rows) holds the sign of each
    switch function, frozen between two switches, so that every piece is smooth; 0 is a mass that sticks.
    """

    def __init__(self, die, hidden=None):
        self.die, self.hidden = die, hidden or Hidden()
        self.outside = self.hidden.outside
        self.memory: dict = {}
        self.switches: dict = {}
        self.terms: list = []
        self.rates: list = []
        self.heated: list = []
        self._matrices: tuple = (None, None)
        h = self.hidden
        self.amplifier = [(c, s) for c, s in enumerate(h.pair("drive_nonlinearity")) if s]
        self.misalignment = (h.force_misalignment_y_to_x, h.force_misalignment_x_to_y)
        self._bent = list(zip(h.pair("pickoff_nonlinearity"), h.pair("pickoff_cubic_nonlinearity"), strict=True))
        self._gain = [1 + e for e in h.pair("pickoff_scale_error")]
        self._leaks = [(c, d, s) for d, a in enumerate("xy") for c, b in enumerate("xy")
                       if (s := getattr(h, f"electrical_feedthrough_{a}_to_{b}"))]  # fmt: skip
        self._crosstalk = [(1, 0, h.pickoff_crosstalk_x_to_y), (0, 1, h.pickoff_crosstalk_y_to_x)]
        self._compressed: list = []
        self.weights = [die.length] * 2 + [die.length * 2 * np.pi / die.period] * 2
        self._springs()
        self._dampers()
        self._outsiders()

    @property
    def jumps(self):
        """Whether a force jumps at a switch."""
        return any(self.friction)

    @property
    def size(self):
        return len(self.weights)

    def linear(self):
        """The same die with nothing hidden."""
        return Plant(self.die)

    def _remember(self, name, weight):
        self.memory[name] = self.size
        self.weights.append(weight)
        return self.memory[name]

    def _watch(self, name, function):
        """Index of the switch of this name, which may already be there."""
        if name not in self.switches:
            self.switches[name] = function
        return list(self.switches).index(name)

    def _springs(self):
        h = self.hidden
        for c in (0, 1):
            for name, law in AXIS_LAWS.items():
                if strength := h.pair(name)[c]:
                    self.terms.append(partial(law, c, strength))
            if ratio := h.pair("parasitic_mode")[c]:
                self._parasitic(c, ratio)
        if h.cross_stiffness:
            self.terms.append(partial(_cross, h.cross_stiffness))
        for name, law in (("angular_acceleration", _turning), ("centrifugal", _centrifugal)):
            if strength := getattr(h, name):
                self.terms.append(partial(law, strength * self.die.mass))

    def _dampers(self):
        h = self.hidden
        self.friction = h.pair("dry_friction")
        for c in (0, 1):
            if strength := h.pair("quadratic_damping")[c]:
                self.terms.append(partial(_air, c, strength, self._speed_switch(c)))
            if self.friction[c]:
                self._speed_switch(c)
        if h.damping_step:
            switch = self._watch("step", lambda t, s, r: t - r.step_time)
            self.terms.append(partial(_stepped, h.damping_step, switch))

    def _speed_switch(self, c):
        return self._watch(f"v{c}", lambda t, s, r: s[2 + c])

    def _parasitic(self, c, ratio):
        h, m = self.hidden, self.die.mass
        z, v = self._remember(f"z{c}", self.weights[c]), self._remember(f"w{c}", self.weights[2 + c])
        w, q = h.parasitic_mode_frequency, h.parasitic_mode_quality
        self.terms.append(partial(_appendage_pull, c, z, ratio * m * w**2))
        self.rates.append(partial(_appendage, c, z, v, w**2, w / q))

    def _outsiders(self):
        o = self.outside
        for c, a in enumerate("xy"):
            if s := getattr(o, f"bouc_wen_{a}"):
                i = self._remember(f"h{c}", o.bouc_wen_yield)
                j, k = self._speed_switch(c), self._watch(f"h{c}", lambda t, s, r, i=i: s[i])
                self.terms.append(partial(_element, c, s, i))
                self.rates.append(partial(_bouc_wen, c, i, j, k, o.bouc_wen_yield))
            if s := getattr(o, f"maxwell_{a}"):
                i = self._remember(f"r{c}", self.weights[c])
                self.terms.append(partial(_element, c, s, i))
                self.rates.append(partial(_maxwell, c, i, o.maxwell_time))
            if s := getattr(o, f"stop_{a}"):
                for side in (1, -1) if o.stop_two_sided else (1,):
                    j = self._watch(f"stop{c}{side}", lambda t, s, r, c=c, side=side: side * s[c] - o.stop_gap)
                    self.terms.append(partial(_stop, c, s, side, j, o.stop_gap))
            if s := getattr(o, f"internal_{a}"):
                z, v = self._remember(f"i{c}", self.weights[c]), self._remember(f"j{c}", self.weights[2 + c])
                w = o.internal_ratio * np.sqrt(self.die.stiffness[c] / self.die.mass)
                self.terms.append(partial(_internal_pull, c, z, s, o.internal_order))
                law = partial(_internal, c, z, v, s / self.die.mass, o.internal_order, w**2, w / o.internal_quality)
                self.rates.append(law)
            if s := getattr(o, f"drive_heating_{a}"):
                i = self._remember(f"heat{c}", 1.0)
                self.heated.append((c, s, i))
                self.rates.append(partial(_heating, c, i, o.drive_heating_force, o.drive_heating_time))
            if getattr(o, f"pickoff_compression_{a}"):
                i = self._remember(f"level{c}", 1.0)
                self._compressed.append((c, getattr(o, f"pickoff_compression_{a}"), i))
                self.rates.append(partial(_level, c, i, o.pickoff_compression_length, o.pickoff_compression_time))

    # ---- motion

    def _matrix(self, rows):
        """Forces [N] by displacement and speed (2, 4, rows); those of the rows last asked for are kept."""
        if self._matrices[0] is not rows:
            kxx, kyy, kxy = rows.stiffness
            dxx, dyy, dxy = rows.damping
            skew = -0.5 * self.hidden.cross_damping_asymmetry + 2 * self.die.mass * rows.rate
            matrix = -np.array([[kxx, kxy, dxx, dxy - skew], [kxy, kyy, dxy + skew, dyy]])
            self._matrices = (rows, matrix)
        return self._matrices[1]

    def applied(self, u, state):
        """Force on the axes from the commanded one (2, rows): amplifier, electrode law, misalignment."""
        u = [u[0], u[1]]
        for c, s, i in self.heated:
            u[c] = u[c] * (1 + s * state[i])
        for c, s in self.amplifier:
            u[c] = u[c] + s * u[c] ** 2
        to_x, to_y = self.misalignment
        return (u[0] + to_x * u[1], u[1] + to_y * u[0]) if to_x or to_y else u

    def force(self, t, state, rows, mode):
        """Everything that acts on the mass [N], two rows of arrays, dry friction excepted."""
        return self._force(state, rows, mode, rows.command(t))

    def _force(self, state, rows, mode, command):
        ux, uy = self.applied(command, state)
        pull = np.einsum("cjr,jr->cr", self._matrix(rows), state[:4])
        f = [ux + pull[0], uy + pull[1]]
        for term in self.terms:
            term(f, state, rows, mode)
        return f

    def slope(self, t, state, rows, mode):
        out, command = np.empty_like(state), rows.command(t)
        force = self._force(state, rows, mode, command)
        out[:2] = state[2:4]
        for c in (0, 1):
            if s := self.friction[c]:
                m = mode[self._speed_switch(c)]
                out[2 + c] = np.where(m == 0, 0.0, (force[c] - s * m) / self.die.mass)
            else:
                np.divide(force[c], self.die.mass, out=out[2 + c])
        for rate in self.rates:
            rate(out, state, mode, command)
        return out

    # ---- switches

    def margin(self, t, state, rows, mode):
        """How far each switch (switches, rows) is from changing: positive while the mode holds."""
        out = mode * np.array([np.broadcast_to(g(t, state, rows), t.shape) for g in self.switches.values()])
        for c, j, s in self._sticking():
            held = mode[j] == 0
            if held.any():
                out[j] = np.where(held, s - np.abs(self.force(t, state, rows, mode)[c]), out[j])
        return out

    def start(self, t, state, rows):
        """State and mode where a row begins; a mass at rest that friction holds, sticks."""
        values = np.array([np.broadcast_to(g(t, state, rows), t.shape) for g in self.switches.values()])
        mode = np.where(values < 0, -1.0, 1.0)
        for c, j, s in self._sticking():
            force = self.force(t, state, rows, mode)[c]
            resting = np.abs(state[2 + c]) < 1e-14 * self.weights[2 + c]
            mode[j] = np.where(resting, np.where(np.abs(force) <= s, 0.0, np.sign(force)), mode[j])
        return state, mode

    def switch(self, t, state, rows, mode, hit):
        """State and mode after the switches in `hit`."""
        after = np.where(hit, -mode, mode)
        for c, j, s in self._sticking():
            force = self.force(t, state, rows, mode)[c]
            state = state.copy()
            state[2 + c] = np.where(hit[j], 0.0, state[2 + c])
            after[j] = np.where(hit[j], np.where((np.abs(force) <= s) & (mode[j] != 0), 0.0, np.sign(force)), after[j])
        return state, after

    def _sticking(self):
        return [(c, self._speed_switch(c), s) for c, s in enumerate(self.friction) if s]

    # ---- read-out

    def voltage(self, state, u):
        """Read-outs (2, rows) [V] before the converter clips, of a state and of the force commanded now."""
        scale, out = self.die.scale, np.empty((2, state.shape[1]))
        for c, (square, cube) in enumerate(self._bent):
            q = self._gain[c] * state[c]
            if square or cube:
                q = q + square * q**2 + cube * q**3
            np.multiply(scale, q, out=out[c])
        for c, s, i in self._compressed:
            out[c] *= 1 - s * state[i]
        out += self.die.offset[:, None]
        for c, other, s in self._crosstalk:
            if s:
                out[c] += scale * s * state[other]
        for c, d, s in self._leaks:
            out[c] += s * u[d]
        return out

    def limit(self):
        """Where the converter clips [V]."""
        s = self.hidden.adc_saturation
        return 1 / s if s else np.inf


# Forces: each adds itself to f, a list of two arrays [N].


def _stepped(step, switch, f, state, rows, mode):
    dxx, dyy, dxy = step * (mode[switch] > 0) * rows.damping
    f[0], f[1] = f[0] - dxx * state[2] - dxy * state[3], f[1] - dyy * state[3] - dxy * state[2]


def _cubic(c, s, f, state, rows, mode):
    f[c] = f[c] - s * state[c] ** 3


def _electrodes(c, s, f, state, rows, mode):
    f[c] = f[c] + s * rows.volts_squared * state[c] ** 3


def _quadratic(c, s, f, state, rows, mode):
    f[c] = f[c] - s * state[c] ** 2


def _squeeze(c, s, f, state, rows, mode):
    f[c] = f[c] - s * state[c] ** 2 * state[2 + c]


def _air(c, s, switch, f, state, rows, mode):
    f[c] = f[c] - s * mode[switch] * state[2 + c] ** 2


def _cross(s, f, state, rows, mode):
    x, y = state[:2]
    f[0], f[1] = f[0] - s * x * y**2, f[1] - s * x**2 * y


def _turning(mass, f, state, rows, mode):
    f[0], f[1] = f[0] + mass * rows.turn * state[1], f[1] - mass * rows.turn * state[0]


def _centrifugal(mass, f, state, rows, mode):
    pull = mass * rows.rate**2
    f[0], f[1] = f[0] + pull * state[0], f[1] + pull * state[1]


def _appendage_pull(c, z, stiffness, f, state, rows, mode):
    f[c] = f[c] + stiffness * (state[z] - state[c])


def _internal_pull(c, z, s, order, f, state, rows, mode):
    f[c] = f[c] - order * s * state[c] ** (order - 1) * state[z]


def _element(c, stiffness, i, f, state, rows, mode):
    f[c] = f[c] - stiffness * state[i]


def _stop(c, s, side, switch, gap, f, state, rows, mode):
    f[c] = f[c] - s * np.where(mode[switch] > 0, state[c] - side * gap, 0.0)


AXIS_LAWS = {
    "cubic_stiffness": _cubic, "electrostatic_cubic_stiffness": _electrodes,
    "quadratic_stiffness": _quadratic, "squeeze_film_damping": _squeeze,
}  # fmt: skip


# What effects remember: each writes the rate of its own part of the state.


def _appendage(c, z, v, stiffness, damping, out, state, mode, u):
    out[z], out[v] = state[v], -stiffness * (state[z] - state[c]) - damping * state[v]


def _internal(c, z, v, push, order, stiffness, damping, out, state, mode, u):
    out[z], out[v] = state[v], -stiffness * state[z] - damping * state[v] - push * state[c] ** order


def _bouc_wen(c, i, speed, spring, bound, out, state, mode, u):
    v, h = state[2 + c], state[i]
    out[i] = v - (mode[speed] * v * h + v * mode[spring] * h) / (2 * bound)


def _maxwell(c, i, time, out, state, mode, u):
    out[i] = state[2 + c] - state[i] / time


def _heating(c, i, force, time, out, state, mode, u):
    out[i] = ((u[c] / force) ** 2 - state[i]) / time


def _level(c, i, length, time, out, state, mode, u):
    out[i] = ((state[c] / length) ** 2 - state[i]) / time
