"""Two coupled modes of a gyroscope: what couples them, by which angle, and the displacement each coupling causes.

The equations of motion are (4) of Zheng et al. (2024), *Identification of coupling error coefficients of a
micromechanical gyroscope from swept-frequency detection*, J. Chinese Inertial Technology 32(2):

    m ẍ + cxx ẋ + cxy ẏ + kxx x + kxy y = Fx cos θx − Fy sin θy + 2 m Ω ẏ
    m ÿ + cyx ẋ + cyy ẏ + kyx x + kyy y = Fx sin θx + Fy cos θy − 2 m Ω ẋ

Divided by the mass, with η = cxy/m = cyx/m, α = kxy/m = kyx/m and force couplings λyx = tan θx, λxy = −tan θy, they are
the `CoupledModes` below. Phasors follow e^{+iωt} throughout: x(t) = Re[X e^{iωt}].
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.plainly import at_once
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.effects import ForceMisalignment
from memsgyro_jax.effects.evaluation import carried


class CoupledModes(Displayed):
    """Linear two-mode gyroscope per unit mass, index 0 = drive axis x, 1 = sense axis y.

    | field | unit | zero means |
    |---|---|---|
    | `omega` (2,) | rad/s | not allowed: square root of kxx/m, kyy/m |
    | `quality` (2,) | 1 | not allowed: m ω / c |
    | `damping_coupling` η | 1/s | no damping coupling |
    | `stiffness_coupling` α | 1/s² | no stiffness coupling |
    | `force_yx` λyx | 1 | the x electrode pushes along x only |
    | `force_xy` λxy | 1 | the y electrode pushes along y only |
    """

    omega: Array = eqx.field(converter=jnp.asarray)
    quality: Array = eqx.field(converter=jnp.asarray)
    damping_coupling: Array = eqx.field(converter=jnp.asarray, default=0.0)
    stiffness_coupling: Array = eqx.field(converter=jnp.asarray, default=0.0)
    force_yx: Array = eqx.field(converter=jnp.asarray, default=0.0)
    force_xy: Array = eqx.field(converter=jnp.asarray, default=0.0)

    @classmethod
    @at_once
    def from_coefficients(
        cls,
        mass: float,
        stiffness: Float[Array, "2 2"],
        damping: Float[Array, "2 2"],
        force_yx: float = 0.0,
        force_xy: float = 0.0,
    ) -> "CoupledModes":
        """From mass [kg] and symmetric stiffness [N/m] and damping [N·s/m] matrices."""
        stiffness, damping = jnp.asarray(stiffness) / mass, jnp.asarray(damping) / mass
        omega = jnp.sqrt(jnp.diagonal(stiffness))
        return cls(omega, omega / jnp.diagonal(damping), damping[0, 1], stiffness[0, 1], force_yx, force_xy)

    @classmethod
    def of(cls, gyro: SingleMassGyro) -> "CoupledModes":
        """The modes of a gyro, inverse of `gyro`; its force couplings are the effect `force_misalignment`.

        **Raises:** `InputError` for a gyro with other effects or unequal cross damping, which are not two such modes.
        """
        force = {"x_to_y": jnp.zeros(()), "y_to_x": jnp.zeros(())}
        for effect in carried(gyro):
            if not isinstance(effect, ForceMisalignment):
                raise InputError(
                    "Argument `gyro` must carry no effect but `force_misalignment` to be two coupled modes, "
                    f"but carries `{effect.label}`; take it off with `gyro.with_only(...)`."
                )
            force[effect.where] = force[effect.where] + effect.strength
        m, omega = gyro.mass, jnp.sqrt(jnp.stack([gyro.kxx, gyro.kyy]) / gyro.mass)
        quality = omega * m / jnp.stack([gyro.dxx, gyro.dyy])
        return cls(omega, quality, gyro.dxy / m, gyro.kxy / m, force["x_to_y"], force["y_to_x"])

    def gyro(self, mass: float) -> SingleMassGyro:
        """The device of this mass [kg] with these modes, as loops, sweeps and fits take it; inverse of `of`."""
        (kxx, kyy), (dxx, dyy) = mass * self.omega**2, mass * self.omega / self.quality
        across = ForceMisalignment("x", "y", self.force_yx), ForceMisalignment("y", "x", self.force_xy)
        kxy, dxy = mass * self.stiffness_coupling, mass * self.damping_coupling
        return SingleMassGyro(mass, kxx, kyy, kxy, dxx, dyy, dxy, effects=across)

    def offset(self, share: Array) -> "CoupledModes":
        """The same modes with their frequencies higher by a share of themselves; the damping stays."""
        return eqx.tree_at(
            lambda m: (m.omega, m.quality, m.stiffness_coupling),
            self,
            (self.omega * (1 + share), self.quality * (1 + share), self.stiffness_coupling * (1 + share) ** 2),
        )

    def stiffness(self) -> Float[Array, "2 2"]:
        """Stiffness over mass [1/s²]."""
        return jnp.diag(self.omega**2) + self.stiffness_coupling * (1 - jnp.eye(2))

    def damping(self) -> Float[Array, "2 2"]:
        """Damping over mass [1/s]."""
        return jnp.diag(self.omega / self.quality) + self.damping_coupling * (1 - jnp.eye(2))

    def force(self) -> Float[Array, "2 2"]:
        """Column j is the force along (x, y) of a unit force on electrode j."""
        one = jnp.ones_like(self.force_yx)
        return jnp.stack([jnp.stack([one, self.force_xy]), jnp.stack([self.force_yx, one])])

    @at_once
    def dynamic_stiffness(self, frequency: Float[Array, " n"], rate: float = 0.0) -> tuple[Array, Array, Array, Array]:
        """Dx, Dy, Cxy, Cyx at angular frequencies [rad/s]: the matrix [[Dx, Cxy], [Cyx, Dy]] takes phasors (X, Y) [m]
        to acceleration [m/s²].

        The rate Ω [rad/s] enters as ∓2iωΩ: a cross damping of opposite sign on the two axes.
        """
        s = 1j * frequency
        # (ω0 − ω)(ω0 + ω) instead of ω0² − ω²: at Q 1e5 the difference of squares would cost five digits near
        # resonance.
        diagonal = [
            (w - frequency) * (w + frequency) + s * w / q for w, q in zip(self.omega, self.quality, strict=True)
        ]
        coupling = self.stiffness_coupling + s * self.damping_coupling
        return diagonal[0], diagonal[1], coupling - 2 * s * rate, coupling + 2 * s * rate

    @at_once
    def response(self, frequency: Float[Array, " n"], axis: int, rate: float = 0.0) -> Complex[Array, "n 2"]:
        """Phasors (X, Y) in steady state for a unit acceleration on electrode `axis` (0 = x, 1 = y) [m per m/s²]."""
        dx, dy, cxy, cyx = self.dynamic_stiffness(frequency, rate)
        fx, fy = self.force()[:, axis]
        return jnp.stack([dy * fx - cxy * fy, dx * fy - cyx * fx], axis=-1) / (dx * dy - cxy * cyx)[:, None]


class AxisAngles(Displayed):
    """Angles [rad] of Fig. 1 of the paper: stiffness axis θω, damping axis θτ, drive electrode θx, sense electrode θy.
    Zero: aligned.
    """

    stiffness: Array = eqx.field(converter=jnp.asarray, default=0.0)
    damping: Array = eqx.field(converter=jnp.asarray, default=0.0)
    drive: Array = eqx.field(converter=jnp.asarray, default=0.0)
    sense: Array = eqx.field(converter=jnp.asarray, default=0.0)

    def modes(self, mass: float, stiffness: tuple[float, float], damping: tuple[float, float]) -> CoupledModes:
        """The coupled modes of a structure with these angles and *principal* stiffnesses [N/m] and dampings [N·s/m]."""
        return CoupledModes.from_coefficients(
            mass,
            _rotated(stiffness, self.stiffness),
            _rotated(damping, self.damping),
            jnp.tan(self.drive),
            -jnp.tan(self.sense),
        )

    @classmethod
    def of(cls, modes: CoupledModes) -> "AxisAngles":
        """The angles of given coefficients, inverse of `modes`: tan 2θω = 2 kxy/(kxx − kyy), tan 2θτ = 2 cxy/(cxx −
        cyy), tan θx = λyx, tan θy = −λxy.

        θω and θτ are those of the first principal value in the larger-first order of the diagonal, within ±90°.
        """
        axis = [0.5 * jnp.arctan2(2 * a[0, 1], a[0, 0] - a[1, 1]) for a in (modes.stiffness(), modes.damping())]
        return cls(axis[0], axis[1], jnp.arctan(modes.force_yx), -jnp.arctan(modes.force_xy))


class ErrorDisplacements(Displayed):
    """Sense displacement, as phasors [m], of each cause while the drive mode moves with phasor X: (5) to (9) of the
    paper.

    `in_phase` and `quadrature` split each cause by the Coriolis displacement of a positive rate.
    """

    coriolis: Complex[Array, " n"]
    damping: Complex[Array, " n"]
    stiffness: Complex[Array, " n"]
    force: Complex[Array, " n"]

    def relative(self) -> dict[str, Complex[Array, " n"]]:
        """Each error over the Coriolis displacement: the real part is in phase with it, the imaginary part in
        quadrature.
        """
        return {name: getattr(self, name) / self.coriolis for name in ("damping", "stiffness", "force")}

    def in_time(self, t: Float[Array, " t"], frequency: float) -> dict[str, Float[Array, "t n"]]:
        """Each displacement [m] over time [s] at the drive frequency [rad/s]."""
        turn = jnp.exp(1j * frequency * t)[:, None]
        return {
            name: (turn * jnp.atleast_1d(getattr(self, name))).real
            for name in ("coriolis", "damping", "stiffness", "force")
        }


def sense_errors(modes: CoupledModes, frequency: Array, amplitude: Array, rate: Array) -> ErrorDisplacements:
    """What the drive motion X = `amplitude` [m] at `frequency` [rad/s] causes on the sense axis at `rate` [rad/s].

    With H = 1/Dy: Coriolis −2iωΩ·H·X (5), damping coupling −iωη·H·X (6), stiffness coupling −α·H·X (7), force coupling
    λyx·Dx·H·X (9) (the electrode force that holds the motion is Dx·X). Damping is exactly in phase with Coriolis,
    stiffness exactly in quadrature; force coupling is in phase at the drive resonance, where Dx is imaginary, and gains
    a quadrature part off it.
    """
    dx, dy, *_ = modes.dynamic_stiffness(jnp.asarray(frequency))
    s, motion = 1j * frequency, amplitude / dy
    return ErrorDisplacements(
        -2 * s * rate * motion,
        -s * modes.damping_coupling * motion,
        -modes.stiffness_coupling * motion + 0j,
        modes.force_yx * dx * motion,
    )


def mirrored(modes: CoupledModes) -> CoupledModes:
    """The same device with x and y exchanged."""
    return CoupledModes(
        modes.omega[::-1],
        modes.quality[::-1],
        modes.damping_coupling,
        modes.stiffness_coupling,
        modes.force_xy,
        modes.force_yx,
    )


def drive_errors(modes: CoupledModes, frequency: Array, amplitude: Array, rate: Array) -> ErrorDisplacements:
    """The mirror image of `sense_errors`: what a sense motion Y = `amplitude` causes on the drive axis (Coriolis has
    the other sign).
    """
    return sense_errors(mirrored(modes), frequency, amplitude, -rate)


def _rotated(principal: tuple[float, float], angle: Array) -> Float[Array, "2 2"]:
    """R(angle) diag(principal) R(angle)ᵀ."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    turn = jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
    return turn @ jnp.diag(jnp.asarray(principal)) @ turn.T
