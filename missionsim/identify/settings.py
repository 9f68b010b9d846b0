"""Every number that decides something in identification and diagnosis, each with its reason.

"Assumed" stands beside values that neither physics nor statistics gives; docs/method.md shows each in its formula.
"""

from __future__ import annotations

from dataclasses import dataclass

ALPHA = 0.002
"""Family-wise false alarms of an effect that enters the model: between 0.002 and 0.01 the study found hardly any right
names and most of the wrong ones."""
DEFAULT_PRIOR_SD = 0.03
"""Relative standard deviation of a base parameter where the robot file gives none (assumed: a careful bench fit)."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Choices of the method that a caller may change.

    Parameters
    ----------
    alpha : family-wise false alarm rate of an effect that enters the model
    period_s : analysis period [s]; slower logs keep their own
    min_share : effects below this share of the energy are called negligible: rows of one second and noisy covariates
        alone make up to 0.5 % of, say, turning scrub (twelve of twelve null cases, mean 0.14 %; from 0.65 % on
        none is named in 76 more)
    max_effects : most effects that enter
    recalibration_limit : shifts of a base parameter up to this many prior sd are recalibration (four: one in 16,000)
    block_s : length of the blocks of the robust standard errors [s], several correlation times of a meter's noise
    form_ratio : an effect explaining less than this part of what a free curve over its covariate explains has
        the wrong form
    rival_loss : a rival of the same covariate within this part of the effect's own gain is not told apart, because
        forms are never exact
    noisy_rival_loss : the same for a rival of another covariate, whose noise weakens what it explains
    systematic : relative systematic allowance of a coefficient (covariate noise), measured on synthetic worlds
    form_error : relative error of an effect's form; weighs more the more of the effect hides in recalibration
    align : estimate delay and lag of the power meter
    """

    alpha: float = ALPHA
    period_s: float = 1.0
    min_share: float = 0.0065
    max_effects: int = 6
    recalibration_limit: float = 4.0
    block_s: float = 20.0
    form_ratio: float = 0.85
    rival_loss: float = 0.03
    noisy_rival_loss: float = 0.12
    systematic: float = 0.07
    form_error: float = 0.03
    align: bool = True


# Runs and analysis intervals

FEWEST_INTERVALS = 8
"""A run with fewer analysis intervals says nothing beside its own offset and gain, and is left out."""
FINEST_STEP_S = 0.1
"""Faster rows are averaged to this step: motion and power of a robot hardly change within it."""
GAP_ROWS = 4.0
"""Rows further apart than this many usual steps have a gap between them: noise is filtered anew behind it."""
SEVERAL_RUNS = 3
"""From here on runs test each other; two values have no scatter to speak of."""

MANY_SECONDS = 100_000.0
"""Length of all fitted runs together [s] from which on stretches of them are learnt from, spread evenly over all."""
LEARNT_SECONDS = 24_000.0
"""Length of these stretches together [s]: limits of detection are then the least share, and what is found is surer than
the form of any effect, so that more would only find errors of forms; time and memory stay bounded."""
STRETCH_S = 600.0
"""Length of such a stretch [s]: many times the correlation of the noise, and several manoeuvres."""

# Noise of the logged speed

TEMPERATURE_S = 60.0
"""Time over which the median of a temperature is taken [s] (assumed): it changes over minutes, its sensor's noise from
row to row."""
TEMPERATURE_ROWS = 60
"""Means of so many stretches of it stand for the rows of a faster log."""
SLOW_ROWS_S = 0.4
"""Faster logs average the noise of their speed within an analysis interval of about a second."""
SPEED_ROWS = 2
"""Rows on either side over which the speed of slower logs is averaged first: ramps are left out."""
SPEED_AVERAGED_S = 10.0
"""Time on either side over which it is averaged then [s]: cruises last longer. Five rows of a second leave half of the
noise, which hid a third of a missing c2 of 2 % of the energy."""
SPEED_JUMPS_BACK = 1.5
"""Usual second difference over usual difference: 1.73 of white noise, 1.41 of a random walk, 0.5 to 0.7 of a car."""
SPEED_NOISY = 0.1
"""A speed whose usual step is a larger part of its usual value jumps about by itself: that is signal, not noise."""
SPEED_AGREE = 4.5
"""Neighbours further apart than this many usual steps (three standard deviations of a difference) lie on a ramp."""

# Clock of meter and motion

CLOCK_SD_S = 0.15
"""What is left of the common delay after it was found [s] (assumed: a tenth of a row or two)."""
CLOCK_SD_S2 = 0.05
"""What is left of the common lag [s2] (assumed, as `CLOCK_SD_S`)."""
JITTER_SD_S = 0.10
"""Delay of a single run's meter against the common one [s] (assumed: time stamps of a common network)."""
LAG_JITTER_SD_S2 = 0.05
"""The same of its lag [s2] (assumed)."""
LARGEST_RUN_DELAY_S = 0.6
"""Delays of single runs beyond this are no jitter, and are cut off."""
RUN_DELAY_SD_S = 0.2
"""Prior of the delays of single runs in the search of the clock [s] (assumed)."""
DERIVATIVE_STEP_S = 0.2
"""Step of the derivatives after the delay [s], about what is left of the clock."""
CLOCK_RISE_NATS = 0.05
"""A step of the clock that gains less ends its search."""
CLOCK_RUNS = 8
"""Of more runs than this a quarter starts the clock; the model refines it with every run."""

# Nuisances of the base model

SWITCH_SD = 0.5
"""Part of a row that counts as switched on though the switch fell inside it: anything from none to all of the row."""
CURVATURE_SD = 0.8
"""Curvature of power over speed, in mean power over mean square speed (assumed: drag of a fast robot)."""

# Noise

HUBER = 2.5
"""Innovations beyond this many standard deviations count less (Huber 1981: 1 % lost where noise is normal)."""
LARGEST_GAIN = 0.05
"""Runs that differ by more than this in gain differ by something that should be named."""
NOISE_FLOOR = 0.3
"""The noise no longer falls below this part of the mean power: a meter has a floor of its own (assumed)."""
NOISE_SPLIT_S = 25.0
"""Border between the correlation times of the fast and of the slow part [s] (assumed)."""
MOST_SLOW = 1.0
"""Largest variance of the slow part against the fast one: what wanders more is no meter, and must not pass for noise
(a load that nobody logged did, which hid what imitates it)."""
MOST_FITTED = 16_000
"""Intervals from which on clock and noise are fitted to some of the runs only, spread evenly over all, and laws are
searched in these: they are surer than they need to be."""
FEWEST_FITTED = 8
"""Runs that the noise is fitted to at least, then to the first part of each; half as many for clock and laws."""
SHARE_PRIOR = 4.0
"""Precision of the weak prior on a share of energy (sd 50 %): keeps runs without the effect harmless."""
UNUSUAL_GAIN = 0.03
"""Runs that differ by this much differ by more than meters (0.5 to 1 %) and drives do; 3 % is told as a finding."""
USUAL_GAIN = 0.015
"""Where the fit of the noise begins again once runs differed by an unusual gain."""

# Search

TRIED = 2
"""So many candidates are fitted with a noise of their own in each step; the third was never the best in the study."""
PROMISING = 0.5
"""A candidate is fitted when its gain before the refit of the noise reaches this part of what is needed: the noise of
the model without it has swallowed some of its gain."""
GLANCE = 0.6
"""A candidate below this part of the least share is not fitted at all: its share hardly changes by a refit, and it
would take the place of one that does."""
CLOSE = 0.6
"""The second best is fitted too when it reaches this part of the best: what it lacks the noise has swallowed."""
SHAPE_NATS = 3.0
"""ln 20, strong evidence (Kass & Raftery 1995): least lead of an effect with a shape of its own over one without."""
JOINT_NATS = 0.5
"""Levels of a label enter a forced fit when they gain this much: about what chance gains."""
FRESH_NATS = 2.0
"""A noise fitted afresh is another optimum where its likelihood is better by this; less is the fits' tolerance."""
MOST_TRIPLES = 20_000
"""Up to so many triples of columns are compared in full (5 ms); beyond, sets that differ in one column."""

# Gates

ONE_RUN_NATS = 3.0
"""What must be left of an effect's gain without the run that shows it best: one in twenty by likelihood."""
ONE_RUN_PART = 0.05
"""The same in parts of its gain: a run that says 95 % of it is a single observation of what is constant in runs."""
RUN_LEVEL = 0.05
"""Level at which an effect counts as repeated across runs in words."""
BESIDE_RUN_LEVEL = 0.005
"""p over runs from which on a second effect whose cause is constant within runs may be a misfit of the larger one."""
NEVER_ON_PART = 0.3
"""Part of a load that its log says was never on from which on an effect up to its whole size may be that load."""
POWER_Z = 0.84
"""Normal quantile of a power of 80 %, at which detection limits are told."""
WORSE_ENERGY_LEVEL = 0.01
"""Level, one-sided over left-out runs, at which an effect that makes their energy worse goes again."""
WORSE_ENERGY = 0.002
"""By no more than this part of the energy, a third of the least share, nothing is made worse that matters, however
surely: of an inertia the runs of a slow meter show 0.1 % each."""
BETWEEN_PART = 0.1
"""A covariate with less than this part of its variance within runs is one observation a run."""

# Refit of shapes

SHAPE_SD = 0.15
"""Width of the weak prior on a shape parameter, relative to its bounds (assumed)."""
SHAPE_EVALUATIONS = 24
"""Evaluations of the profile likelihood for each shape parameter."""
LIMIT_NATS = 1.92
"""Half the 95 % quantile of chi-square with one degree of freedom: profile-likelihood limits."""

# Credible set

ODDS_NATS = 4.6
"""ln 99: a rival further behind has less than a hundredth of the weight. A name that stands alone should be as sure."""
SAME_COLUMN = 0.995
"""Columns this much alike away from ramps are one: what then prefers one of them is noise."""
NOISY_SLOPE = 2.0
"""A slope from an inertial sensor has noise and a bias of its own, which weakens a slope effect more than others."""
APART = 0.5
"""Two powers of which no more than this part is the same in a run differ there by more than noise of a cause."""
ACTS_PART = 0.1
"""Of the squared power in the run with most, two causes leave less in a run where neither acts (assumed)."""
KEPT_PART = 0.7
"""Part of its size that an effect keeps beside the most that another one may have of it, or that is told: true ones
alone keep 0.74 or more (study), one of two that are both there 0.58 to 0.69."""
THERE_SD = 3.0
"""Or whose size beside it is more than this many standard errors: true ones alone have up to 2.3, one of two that are
both there, and refused, 3.7 (worlds of other formulas)."""
RIVAL_PART = 0.5
"""Beside what leaves a label more than this part of its gain, it is no question of either-or."""
EXTRA_EFFECT_NATS = 4.0
"""Price of an explanation that needs one effect more (its choice among some fifty columns)."""

# Intervals

RAMP_SYSTEMATIC = 0.3
"""Further relative allowance of a coefficient that rests on ramps, which the meter's lag and the averaging blur."""

# Structure of the residual

KNOTS = 6
"""Knots of a free curve over a covariate: five free values bend as friction and drag do, and hardly follow noise."""
LONG_BLOCK_S = 60.0
"""Blocks of the sandwich of a curve's test [s], longer than the slow noise usually lasts."""
CURVE_LEVEL = 1e-4
"""Level, shared by all covariates, at which the residual depends on one."""
CURVE_NATS = 8.0
"""Least gain of a curve [nats], about what slow noise gives five free values."""
LEAST_LEFT = 0.005
"""Least size of what neither the base nor the effects take of a curve, in parts of the mean power (measured: 0.0031 to
0.0035 by rows of a second in which a robot starts, 0.026 to 0.055 for what is missing)."""
CURVE_NATS_ON_RAMPS = 50.0
"""The same with rows beside ramps in, which bend curves."""
RAMP = 0.03
"""Rows beside a change of the base model by this part of the mean power lie on a ramp."""
RAMP_TAIL_ROWS = 2
"""Rows behind a ramp that still count as such: the meter's lag."""
RAMP_WEIGHT = 0.002
"""Weight of such rows in tests of form: next to none, but enough to keep the matrices regular."""
STEADY_PART = 0.05
"""Part of an effect's gain that must come from other rows, for its form to be judged by them."""
FREER = 3.0
"""In tests of form base parameters are freer than their priors by this factor: no shift may look like a form."""
HELD = 0.01
"""Part of its prior standard deviation that a base parameter is held to where an effect is its twin."""
SUPPORT_S = 8.0
"""A knot that less time away from ramps supports says nothing of the curve [s]."""
FEWEST_HATS = 3
"""Fewer supported knots than this are no curve."""
FORM_LEVEL = 1e-3
"""Level of the one test of an effect's form; a misfit must be large as well."""
FORM_FAINT = 0.02
"""Where the gain beyond the form is large, this level suffices: few blocks carry the test."""
FORM_NATS = 20.0
"""Gain beyond the form that is large."""
FORM_SURE = 1e-5
"""A misfit below the gross one must be this sure."""
GROSS = 0.45
"""An effect that explains less than this part of what a free curve explains is wrong even where the misfit is faint."""
RAMP_FORM_RATIO = 0.5
"""The same with rows beside ramps in, where only a gross misfit counts."""
STANDS = 0.5
"""An effect that keeps less of its gain beside the free curve of another structure may be the shadow of that."""
SLOW_NOISE_S = 30.0
"""Time over which the noise is averaged to tell low-frequency noise from a meter's [s]."""
SLOW_NOISE = 0.03
"""Standard deviation of such means, in parts of the power, that no meter makes (worlds: 0.9 to 1.9 %)."""
PERIODIC_LEVEL = 1e-6
"""Level of a periodic load; imperfect whitening reaches 2e-4 on nothing."""
LINE_RATIO = 8.0
"""A line in the periodogram stands out of its neighbourhood this much: imperfect whitening makes small bumps."""
FAINT_NATS = 50.0
"""Beside low-frequency noise or a periodic load, an effect with less gain is not named."""

# One factor between meter and model

LEVEL_SHARE = 0.10
"""A difference of the energies in all runs, beyond recalibration and effects, that no good meter makes."""
AT_LEVEL = 0.05
"""Where the file as it stands gives the measured energy within this, no factor lies between meter and model."""
AS_MUCH = 0.9
"""A single factor that explains this part of what the effects explain is the simpler answer."""
LEAST_FREE_SD = 1.0
"""Relative standard deviation that stands for no prior at least; such parameters follow the meter."""

# A systematic error in one kind of motion

MOST_OF_SQUARE = 0.5
"""Part of the squared error that a kind of motion must hold to be told."""
SMALL_TIME = 0.25
"""Part of the time that it may take at most: more is the ordinary error of the model."""
RARE_TIME, PEAKS, FEWEST_PEAKS = 0.02, 0.6, 5
"""Part of the time, the part of the squared error that is left which its rows must hold to be told as peaks, and how
many there must be (assumed; of normal noise it is 0.15, of Student's with three degrees of freedom 0.44)."""
CLEAR_T = 5.0
"""Mean over runs in its own standard errors; with three runs p = 0.04, beside everything else that is asked."""
CLEAR_OF_NOISE = 2.0
"""Mean error in standard deviations of a single row's noise; the mean of many rows strays far less."""

# Passes of the diagnosis and experiments

MOST_PASSES = 3
"""Times that columns are evaluated anew at the size found; the second changes it by less than a per cent."""
SAME_SIZE = 0.05
"""A column is evaluated anew when the size found differs by more than this from the one that it was made for."""
SHIFTED_RATIO = 1.2
"""Runs left out by condition lie beyond the others' largest value of it by this factor, or by the next in the mean."""
SHIFTED_MEAN_RATIO = 1.5
"""See `SHIFTED_RATIO`."""
ENOUGH_NATS = 12.0
"""Expected lead at which a manoeuvre need not be longer: it resolves the question in 97 of 100 cases."""
DECIDED_NATS = 2.944
"""ln 19: lead at which the credible set of two has one member."""
BETTER_NATS = 1.0
"""A manoeuvre that raises the lead by less is not proposed."""
LENGTHS = (1, 2, 4)
"""Times its usual length that a manoeuvre may be driven."""
MOST_PROPOSED = 2
"""Manoeuvres proposed: the best and one to choose in its place."""

# Selection by prediction, where the base is far from right

ROUGH = 0.25
"""Error of the recalibrated base on left-out runs, as part of the mean power, from which its form is far from right:
worlds in which one effect of 5 % is missing stay below 0.2, real robots under a speed-only base come to 0.4 to 2."""
OFTEN, OFTEN_PART = 0.15, 0.2
"""Such an error is that of more than this part of the time: a base that only lacks surges or jolts stays below 0.06
there, real robots under a speed-only base exceed 0.4."""
FEWEST_FOLDS = 8
"""With few runs each is cut into stretches of time: a jackknife over two or three values says nothing."""
SHORTEST_FOLD_S = 30.0
"""No stretch is shorter than this [s]: it must hold more than one manoeuvre."""
TOLD_APART = 0.01
"""Part of the squares of a cause over all runs that another must leave for both to be told apart at all (assumed)."""
SHOWN_ALONE = 0.5
"""A run within which more than this part of what tells two effects apart lies is cut (assumed): without it the others
say nothing of it."""
STRETCHES = 4
"""Stretches of such a run: a half of a drive, with the load and then without, would lack the other half."""
INDEPENDENT_S = 20.0
"""Rows this far apart count as independent where a prior is weighed against the data [s], as in the robust blocks."""
LEAST_FALL = 0.03
"""Part of the squared error on left-out runs that an effect must take away; chance and wrong forms take 1 to 2 %."""
ENERGY_FALL = 0.005
"""The same where the energy of left-out runs is predicted better beyond chance."""
PASS_THROUGH_FALL = 0.002
"""The same for watts that are logged beside: they are drawn, only whether this battery feeds them is asked."""
LARGEST_PASS_THROUGH = 2.0
"""Watts logged beside come with at most this factor: no converter loses more than half."""
LEAST_PASS_THROUGH = 0.5
"""And with at least this one: what is drawn is drawn whole, and a column that is noisy or late loses less than half."""
USUAL_PASS_THROUGH = (0.8, 1.25)
"""The factors of converters and of columns with errors of a fifth at most: what two standard errors keep away from them
is no better known to be drawn than any other effect, and has rivals as these do."""
FAMILY_LEVEL = 0.05
"""Family-wise level of the Wald test with errors clustered by run, where the error of left-out runs falls by
`LEAST_FALL` as well: with 6 to 13 runs a tenth of it has no power. A label that is constant in runs asks one question
of its own at that level: whether its levels predict left-out runs better than when dealt out among the runs anew."""
STRICT_LEVEL = 0.01
"""The same where that error hardly falls, or where stretches of few runs, no draws of their own, are the sample."""
LABEL_LEVEL = 0.01
"""Level of a label's one question beside a base that is near: whether runs differ by its levels (F)."""
HALVED, HALVED_LEVEL = 0.5, 0.05
"""An effect that leaves less than this part of the squared error on left-out runs is there at this level: its size may
differ from run to run, so that the Wald test over few of them has no power."""
LOUDER = 10.0
"""An effect that takes this many times off the error of left-out runs what logged watts do is no imitation of them,
though they are lost beside it (assumed; of a car's inertia beside its air conditioning it is 270)."""
TWINS, TWIN = 1.1, 0.75
"""A base without priors that leaves no more than this part of the squared error refutes the file: the first where two
effects that stand in for its parameters were found, or one and the base is far from right; the second where one of the
two holds."""
SWALLOWED = 0.6
"""Part of the squared error on left-out runs below which the selection by prediction stands though the base is near:
the offsets or the slow noise of the other had taken what a noisy or late column says."""
UNCLEAR = 2.0
"""Standard errors of a paired difference between two effects below which runs do not tell them apart."""
NESTED = 1e-6
"""Columns with no more than this part outside the span of others are a special case of them, and no rival."""
DELAY_LEVEL = 0.01
"""Level of the paired test over runs at which a delay or lag of the meter is taken."""
NEAR_LEVEL = 0.05
"""The same of one that lies near what the likelihood has found."""
SLOW_LEFT = 0.01
"""Part of a bounded noise that may be slow: hardly any, since that is where a missing effect hides."""
WIDE, HIDES = 10.0, 0.5
"""An effect whose share of the energy may be this many times larger than at the least, while more than this part of it
hides in a recalibration of the base, may stand for a small part of its own form alone (in worlds of six simulators and
on a car, nine of twelve such names were wrong; of those with a narrower interval hardly any)."""
