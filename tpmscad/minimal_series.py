"""Minimal surfaces as zero sets of short trigonometric series: the nodal formula, continued until the mean curvature vanishes.

The zero set of a series f(X) = Re sum_k a_k exp(2 pi i k . X), X in cells, has the symmetry of the nodal formula of its name, and
its mean curvature is zero within the stated residual, although Weierstrass data of the surface need not be known. A term is the
sum over the orbit of one wave vector under the symmetries of the surface.

A surface is minimal if its mean curvature H vanishes. With N = grad f / |grad f| and h the Hessian of f,
H = (tr h - N . h N) / (2 |grad f|); Levenberg-Marquardt steps on H at points of the surface give the coefficients
(`python -m benchmarks.minimal_series`). f and g f, g > 0, have the same surface; among such functions the smoothest series is
taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np

from tpmscad._typing import Array

Operation = tuple[str, int]
"""A symmetry in coordinates, "-x, y, z+1/2", and the sign s of f(image) = s f(x, y, z)."""

WaveVector = tuple[int, int, int]

VANISHING = 1e-9
"""Amplitude, relative to the order of the group, below which a wave of an orbit cancels."""


@dataclass(frozen=True, slots=True)
class MinimalSeries:
    """The series of one surface.

    - `generators`: symmetries that generate all of them, modulo translations by a cell.
    - `coefficients`: amplitude of every wave in the orbit of a wave vector, by the vector; sines if f is odd, else cosines.
    - `mean_curvature`: greatest |H| at points of the zero set, period times curvature.
    - `nodal_distance`: greatest distance from the nodal surface, in cells.
    - `value_range`: minimum and maximum of f.
    """

    generators: tuple[Operation, ...]
    coefficients: Mapping[WaveVector, float]
    mean_curvature: float
    nodal_distance: float
    value_range: tuple[float, float]

    @property
    def is_odd(self) -> bool:
        """Whether f(-X) = -f(X)."""
        return INVERSION_ODD in self.generators


INVERSION_ODD: Operation = ("-x, -y, -z", -1)

Placement = tuple[Array, Array, int]
"""Rotation (3, 3), translation (3,) in cells and sign of a symmetry."""


def read_operation(operation: Operation) -> Placement:
    """The rotation, translation and sign of a symmetry given by the coordinates of the image."""
    text, sign = operation
    rotation, translation = np.zeros((3, 3), int), np.zeros(3)
    for row, part in enumerate(text.split(",")):
        letter, _, shift = part.strip().partition("+")
        rotation[row, "xyz".index(letter[-1])] = -1 if letter.startswith("-") else 1
        if shift:
            above, below = shift.split("/")
            translation[row] = int(above) / int(below)
    return rotation, translation, sign


def generate_group(generators: tuple[Operation, ...]) -> list[Placement]:
    """All products of the generators modulo translations by a cell; translations are multiples of a quarter, exact in floats."""
    every = [read_operation(operation) for operation in generators]
    identity: Placement = (np.eye(3, dtype=int), np.zeros(3), 1)
    found, fresh = {_key(identity): identity}, [identity]
    while fresh:
        rotation, translation, sign = fresh.pop()
        for other, shift, factor in every:
            word = (rotation @ other, np.mod(rotation @ shift + translation, 1.0), sign * factor)
            if _key(word) not in found:
                found[_key(word)] = word
                fresh.append(word)
    return list(found.values())


def _key(placement: Placement) -> tuple[object, ...]:
    rotation, translation, sign = placement
    return *rotation.ravel().tolist(), *translation.tolist(), sign


def expand_orbit(group: list[Placement], wave_vector: WaveVector, is_odd: bool) -> dict[WaveVector, complex]:
    """Amplitudes of the waves in the orbit of a wave vector, of modulus 1, one of each pair k and -k; empty if they cancel."""
    first = np.array(wave_vector)
    amplitudes: dict[WaveVector, complex] = {}
    for rotation, translation, sign in group:
        k, amplitude = first @ rotation, sign * np.exp(2j * np.pi * (first @ translation)) * (-1j if is_odd else 1.0)
        if next((c for c in k if c), 0) < 0:
            k, amplitude = -k, np.conj(amplitude)
        h, m, n = (int(c) for c in k)
        amplitudes[h, m, n] = amplitudes.get((h, m, n), 0.0) + amplitude
    greatest = max(abs(a) for a in amplitudes.values())
    if greatest < VANISHING * len(group):
        return {}
    return {k: complex(np.round(a / greatest, 12)) for k, a in amplitudes.items()}


@cache
def expand_series(name: str) -> tuple[Array, Array]:
    """Wave vectors (W, 3) and complex amplitudes (W,) of the series of a surface of `MINIMAL_SERIES`; both are read-only."""
    series = MINIMAL_SERIES[name]
    group = generate_group(series.generators)
    waves: dict[WaveVector, complex] = {}
    for wave_vector, coefficient in series.coefficients.items():
        for k, amplitude in expand_orbit(group, wave_vector, series.is_odd).items():
            waves[k] = coefficient * amplitude
    vectors, amplitudes = np.array(list(waves), float), np.array(list(waves.values()))
    vectors.setflags(write=False)
    amplitudes.setflags(write=False)
    return vectors, amplitudes


def _read_table(text: str) -> Mapping[WaveVector, float]:
    """Coefficients by wave vector, from entries "h k l coefficient" separated by semicolons."""
    table = {}
    for entry in text.replace("\n", ";").split(";"):
        if entry.strip():
            h, k, n, coefficient = entry.split()
            table[int(h), int(k), int(n)] = float(coefficient)
    return MappingProxyType(table)


_CUBIC_MIRRORS: tuple[Operation, ...] = (("y, z, x", 1), ("y, x, z", 1), ("-x, y, z", 1))
"""All permutations and reversals of the axes."""

GENERATORS: Mapping[str, tuple[Operation, ...]] = MappingProxyType(
    {
        "gyroid": (INVERSION_ODD, ("y, z, x", 1), ("-x+1/2, -y, z+1/2", 1), ("-x+1/4, -z+1/4, -y+1/4", 1)),
        "diamond": (
            INVERSION_ODD,
            ("y, z, x", 1),
            ("x, -z+1/4, -y+1/4", 1),
            ("x, y+1/2, z+1/2", 1),
            ("x+1/2, y+1/2, z+1/2", -1),
        ),
        "schwarz_p": (*_CUBIC_MIRRORS, ("x+1/2, y+1/2, z+1/2", -1)),
        "iwp": (*_CUBIC_MIRRORS, ("x+1/2, y+1/2, z+1/2", 1)),
        "neovius": (*_CUBIC_MIRRORS, ("x+1/2, y+1/2, z+1/2", -1)),
        "frd": (*_CUBIC_MIRRORS, ("x, y+1/2, z+1/2", 1)),
        "fischer_koch_s": (INVERSION_ODD, ("y, z, x", 1), ("-x+1/2, -y, z+1/2", 1), ("x+1/4, z+1/4, y+1/4", 1)),
    }
)
"""The symmetries of the nodal formulas, those that exchange the sides included."""

MINIMAL_SERIES: Mapping[str, MinimalSeries] = MappingProxyType(
    {
        "gyroid": MinimalSeries(
            GENERATORS["gyroid"],
            _read_table("""
1 1 0 0.5; 3 1 0 0.0014374872878380098; 2 2 2 -0.002185853256176636
3 2 1 0.002406575344811009; 4 1 1 -0.001300527755779554; 3 3 0 0.0016800226476268558
5 1 0 0.0016292599195211553; 4 3 1 0.0011485453680366953; 5 2 1 0.0015433413310508507
5 3 0 0.001268020450241768; 4 3 3 0.0006918784643055011; 4 4 2 0.0008911200370205592
5 3 2 0.0005023989058928067; 5 4 1 0.0009715137743513566; 6 2 2 0.0006160978904490537
6 3 1 0.0001755688844647843; 7 1 0 -0.0002140529831926055; 5 5 0 0.0009712892281504271
5 4 3 0.00012645617215203324; 7 2 1 0.00017197354874873153; 6 4 2 0.0002685831963172091
7 3 0 -2.4734102543229876e-05; 7 3 2 2.8336212461765796e-05; 6 5 1 0.00012235162977686974
8 1 1 5.8327558874910134e-08; 7 4 1 3.833771846996811e-05; 5 5 4 -0.00031204179419340087
6 4 4 -0.00015961939403735085; 6 5 3 -0.00010286575848873695; 8 3 1 -5.101924494698944e-07
7 5 0 9.50029114596489e-06; 7 4 3 -6.3879145968227446e-06; 6 6 2 -2.306491381888471e-05
7 5 2 -2.106142931972656e-06
"""),
            mean_curvature=1.1e-10,
            nodal_distance=0.001344,
            value_range=(-1.534768181396369, 1.5347681813963694),
        ),
        "diamond": MinimalSeries(
            GENERATORS["diamond"],
            _read_table("""
1 1 1 0.5; 3 1 1 0.008985292682828777; 3 3 1 -0.00016201412706760883
5 1 1 2.909830962914271e-06; 3 3 3 -2.974049373323303e-06; 5 3 1 4.657298972309426e-08
"""),
            mean_curvature=2.9e-10,
            nodal_distance=0.0007528,
            value_range=(-1.3393132489376314, 1.3393132489376314),
        ),
        "schwarz_p": MinimalSeries(
            GENERATORS["schwarz_p"],
            _read_table("""
1 0 0 1.0; 1 1 1 -0.009472198442393734; 2 1 0 0.016781164888064352
3 0 0 -0.006282633649355545; 2 2 1 -0.00426848047458063; 3 1 1 -0.0003365976233534323
3 2 0 0.00030746849975709696; 4 1 0 -6.769191297105283e-05; 3 2 2 8.99698457818757e-05
3 3 1 -1.7915493445644947e-05; 4 2 1 -1.1926047844620985e-05; 5 0 0 9.550280851025566e-08
4 3 0 -2.0775348946369373e-07; 5 1 1 -1.4522783254146623e-08; 3 3 3 -2.9965000196525233e-08
5 2 0 6.676959200315691e-09; 4 3 2 -1.2677403343072396e-08; 5 2 2 -2.487101506756989e-09
4 4 1 -5.904832896991934e-09; 5 3 1 -1.8143388452209152e-09
"""),
            mean_curvature=1.8e-11,
            nodal_distance=0.01191,
            value_range=(-3.092829223836755, 3.092829223836755),
        ),
        "iwp": MinimalSeries(
            GENERATORS["iwp"],
            _read_table("""
0 0 0 0.4246289177398695; 1 1 0 1.0; 2 0 0 -0.029181077527695158
2 1 1 0.08725489081274446; 2 2 0 -0.010256310574234729; 3 1 0 0.048312783159307024
2 2 2 -0.015267247208540105; 3 2 1 -0.019140434641485845; 4 0 0 0.001037731808400101
4 1 1 0.01351595935881947; 3 3 0 -0.022328178036860345; 4 2 0 0.014297978658591894
3 3 2 -0.005274077190955578; 4 2 2 -0.003891592322881407; 5 1 0 -0.01499787262693511
4 3 1 0.0019274241394247231; 5 2 1 -0.003445518439194259; 4 4 0 0.0019719831288012375
5 3 0 -0.0012622038429838504; 4 3 3 0.0003105675623846385; 6 0 0 0.0026510922748370735
4 4 2 0.000452918739488143; 6 1 1 0.0012273227436123734; 5 3 2 -0.0005386477508046803
6 2 0 0.00017355198968737126; 5 4 1 -0.00013670997288563433; 6 2 2 0.000102295165965657
6 3 1 -5.35830811850533e-05; 4 4 4 2.8220133435790775e-05; 7 1 0 -5.1405733255169555e-05
5 5 0 -2.324007014215708e-05; 5 4 3 -8.299613315887541e-06; 6 4 0 1.2739222842290427e-05
7 2 1 -1.1813486181809804e-05; 6 3 3 5.690322853744029e-05; 5 5 2 -6.051256388427526e-05
6 4 2 2.129180677605146e-05; 7 3 0 -4.790744183088731e-06; 7 3 2 -1.4885000707364176e-05
6 5 1 -7.492418019724338e-07; 8 0 0 -1.7295034111115414e-05
"""),
            mean_curvature=5.4e-08,
            nodal_distance=0.04724,
            value_range=(-1.9403253465553183, 7.271788951339274),
        ),
        "neovius": MinimalSeries(
            GENERATORS["neovius"],
            _read_table("""
1 0 0 3.0; 1 1 1 1.4321725356597645; 2 1 0 0.47557568420051277
3 0 0 -0.17013211729649003; 2 2 1 0.064375303087184; 3 1 1 -0.09978224304931048
3 2 0 -0.0564396773256809; 4 1 0 -0.09639612616471663; 3 2 2 -0.022483199040890366
3 3 1 -0.006687143463144331; 4 2 1 -0.026707093992802917; 5 0 0 -0.011073179325327087
4 3 0 -0.0016722604063367282; 5 1 1 -0.0012341070176252196; 3 3 3 0.0060532506617204255
5 2 0 0.004868650741579952; 4 3 2 0.00023629943262955456; 5 2 2 0.0027513713043778557
4 4 1 0.00440977286746187; 5 3 1 0.0024339879925718865; 6 1 0 6.093320195356848e-05
6 2 1 0.0005908168544585857; 5 4 0 0.0016113764551770231; 4 4 3 0.00032631548407858265
5 3 3 0.0003527801717989707; 6 3 0 0.000545830304823591; 5 4 2 0.00031605413941741253
7 0 0 -0.00027583264082343007; 6 3 2 0.00015563773334568347; 7 1 1 8.335793469024998e-05
5 5 1 0.0002910034810407877; 7 2 0 5.989063409377282e-05; 6 4 1 5.096175120240083e-05
7 2 2 4.8992954183162016e-06; 5 4 4 4.33416281810845e-06; 7 3 1 -1.3316556207026433e-05
5 5 3 2.8193774162419526e-05; 6 5 0 -2.5716333775999443e-05; 6 4 3 7.812295228741552e-06
"""),
            mean_curvature=2.5e-07,
            nodal_distance=0.01324,
            value_range=(-16.90571828069057, 16.90571828069057),
        ),
        "frd": MinimalSeries(
            GENERATORS["frd"],
            _read_table("""
0 0 0 0.21071626883148087; 1 1 1 1.0; 2 0 0 0.1186058591734858
2 2 0 -0.05741289111752835; 3 1 1 0.07550326105024768; 2 2 2 -0.01922906932599185
4 0 0 0.023664324832713628; 3 3 1 -0.0165617293995279; 4 2 0 -0.016521476838344526
4 2 2 0.002252877144796278; 5 1 1 -0.0042447741289008455; 3 3 3 -0.017524771539752952
4 4 0 0.0068569294523349615; 5 3 1 0.0014214295465661514; 6 0 0 0.0020419759060246413
4 4 2 0.00544653554257239; 6 2 0 0.0005612678822648501; 5 3 3 -0.0012209439808921613
6 2 2 0.00035905857964400813; 4 4 4 -7.233095778837931e-05; 7 1 1 -0.0013168088670578273
5 5 1 0.0003923395945483991; 6 4 0 0.0013391043886441117; 6 4 2 0.001674232816311005
7 3 1 0.00024672997943293087; 5 5 3 0.000706416369593741; 8 0 0 -0.00028198587802001293
7 3 3 1.6843096923570808e-05; 8 2 0 0.00019129955448009064; 6 4 4 0.0004954732232607809
8 2 2 -3.357477643721764e-05; 6 6 0 0.00018127832141838667; 7 5 1 9.203755650739538e-05
5 5 5 -7.779860065194102e-05; 6 6 2 9.579231395890642e-05; 8 4 0 2.417704077262444e-06
9 1 1 6.179333569691296e-05; 7 5 3 0.00010723572248364828; 8 4 2 7.011328628543916e-05
6 6 4 6.83773144773535e-05; 9 3 1 5.6802376952853584e-05; 8 4 4 6.015961083694274e-06
9 3 3 2.5584296719071183e-05; 7 7 1 9.496099319220173e-06; 7 5 5 3.117261716806242e-05
10 0 0 -3.950609595559115e-05; 8 6 0 2.1302160192324073e-05
"""),
            mean_curvature=4.6e-06,
            nodal_distance=0.02093,
            value_range=(-4.3800906450442545, 4.8531156845778805),
        ),
        "fischer_koch_s": MinimalSeries(
            GENERATORS["fischer_koch_s"],
            _read_table("""
2 1 1 0.24999999999999994; 3 1 0 -0.002545565008762302; 3 2 1 -0.010225242445275715
3 3 2 0.010712163196215874; 4 2 2 -0.003792974390594176; 5 1 0 0.008658676760437297
4 3 1 -0.011030306093082807; 5 2 1 0.003305151879033972; 5 3 0 -0.009891218609432416
6 1 1 -0.007583003712495076; 5 3 2 -0.005054842709517436; 5 4 1 -0.0005479187361238882
6 3 1 0.0018590352029821929; 4 4 4 -0.00474689353530535; 7 1 0 3.6074612144933315e-05
5 4 3 0.0005578985145135503; 7 2 1 -0.0003137811510085379; 6 3 3 -0.0006534591137012185
5 5 2 -0.001172184478731463; 6 4 2 -0.000747981161886253; 7 3 0 -0.00042596460409524895
7 3 2 -0.001628348488076084; 6 5 1 -0.0008483047824035989; 7 4 1 -0.0005540758404261461
6 5 3 -2.4429272557546658e-05; 8 2 2 -0.0008848048818106292; 8 3 1 -0.0014772480525104528
7 5 0 -0.0003274396660695932; 7 4 3 0.0006526858965997766; 7 5 2 0.0007977496191418019
9 1 0 0.0003666159654264078; 8 4 2 0.00027305155656508244; 9 2 1 0.00012747853254927238
7 6 1 0.000551340776056361; 6 5 5 0.002403753939565648; 6 6 4 0.0021640868580501435
9 3 0 -0.0006206395477095742; 8 5 1 0.0006818286775323542; 7 5 4 0.0016299125758795743
9 3 2 -0.0003437528518301963; 7 6 3 0.0007770572208546211; 8 4 4 0.00037132946351415354
9 4 1 -4.545834653705424e-05; 8 5 3 0.0004198929001960789; 10 1 1 0.00020338514226668196
7 7 2 -0.00019758816429183999; 8 6 2 0.00015315076756353919; 9 5 0 0.00017242058763621424
9 4 3 -5.2831521873151196e-05; 10 3 1 -0.0001658774539256519; 9 5 2 0.00013062089022678014
7 6 5 0.00010588780263682714; 8 7 1 -0.00013172132215130588; 8 6 4 0.00017175612920138647
10 3 3 -6.124842304465412e-05; 9 6 1 3.3943121947317956e-05; 10 4 2 1.4094696553014912e-05
11 1 0 -9.582615556838582e-06; 9 5 4 5.756052460379657e-05; 8 7 3 2.710306253505323e-05
11 2 1 2.494316588598167e-06; 10 5 1 3.6634344398099586e-05; 9 6 3 6.877959581161702e-05
11 3 0 2.448539990561783e-06; 9 7 0 -1.1789588886581104e-05; 11 3 2 1.541948523106569e-06
10 5 3 1.5526033973735483e-05; 9 7 2 9.9406121991461e-07; 7 7 6 0.00011400884219461336
8 6 6 7.747694322210153e-05; 11 4 1 -5.214041868761427e-08; 8 7 5 2.587310951213511e-05
10 6 2 2.7656312497947465e-06; 9 6 5 1.5053620770426362e-05; 8 8 4 1.9725538068394887e-06
"""),
            mean_curvature=5.7e-07,
            nodal_distance=0.00898,
            value_range=(-1.7130915762867374, 1.7130915762867374),
        ),
    }
)
"""The series by the name of the surface."""
