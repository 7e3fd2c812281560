"""Every number that changes a verdict of the diagnosis: value, unit, what it guards, and its reason.

A rule's docstring begins with its unit in brackets ([-]: a pure number, [ln]: log evidence, [sd]: standard errors, [lambda]:
squared whitened length of a signature) and names its `Reason:`, a formula, a source, a test, or honestly that none is known.
Tolerances, batch sizes and step counts of solvers, shapes of features and the imagined measurements of `foresee` stand where they
are used; tests/diagnose/test_rules.py holds the line between the two.
"""

import numpy as np

# ---------- priors: before any reading
PRIOR_EFFECTS = 0.15
"""[-] Effects expected in a data set before it is seen; shared by kinds of effects, then by joints. Guards: machines without
an effect are not accused. Reason: three of 180 machines by another hand with nothing planted (docs/diagnosis.md, Measured); of
the first 120 one, at 0.3 four, and the first name is as often right."""

SMALLER = 0.2
"""[-] Of the usual range's lower end: the least of the prior widths of what the background has no little of. Guards: a small
effect that many rows show is not told as something unknown, nor left out beside another. Reason: a runout of 2 um, a splice of
0.2 N and stock of 19 um in force logs of the blind check (seed 5846, worlds 105, 5, 15) had no name without it."""

PRIOR_UNKNOWN = 0.05
"""[-] Probability of an effect outside the catalogue before any reading, shared by kinds of kernels, then by joints. Guards:
'none of these' against names. Reason: one cell in twenty; what it answers in worlds outside the catalogue is in
docs/blindtest.md."""

BROKEN_ORDER_ODDS = 0.2
"""[-] A ripple of a broken order against other kernels. Guards: 'none of these' is not said for a gear's ripple. Reason:
most orders of a gear are whole numbers, and these are in the catalogue."""

BACKGROUND_RIPPLE = 0.28
"""[-] Of the lower end of the typical range: one sigma of a good gear's ripple, in every joint. Guards: real machines are
not accused of the ripple that all have. Reason: set with its odds on machines with nothing planted (docs/diagnosis.md)."""

QUIET = 0.995
"""[-] Probability with which the other gears of a machine must have less ripple than BACKGROUND_RIPPLE before one of them is
held to less. Guards: as BACKGROUND_RIPPLE; one quiet gear among five tells little of a sixth. Reason: of 30 machines of the
blind check with ripple in all gears (seed 3) none is accused; four at 0.95."""

BACKGROUND_PLAY = np.array([0.07, 0.15, 0.28, 0.4])
"""[-] Of the lower end of backlash's range: sizes of a good machine's play, in all joints at once. Guards: as
BACKGROUND_RIPPLE. Reason: as there; below 0.4, so that a joint at the lower end stands out."""

RIPPLE_ODDS = 0.04
"""[-] Prior odds of a ripple of that size in one joint. Guards: the smaller, the sooner an effect just above it is named,
and the more machines without one are accused. Reason: of 150 virtual machines with such a background none is accused."""

LINES_A_GEAR = 3
"""[lines] Of a gear's ripple that a set may hold in the background. Guards: the name of one line against standing for the second.
Reason: real gears have several ripples (PHYSICS 6, Masses)."""

FURTHER_LINES = 4
"""[lines] Up to so many of a gear's ripple, too small to stand out, evenly. Guards: what a corrected model is promised to leave.
Reason: real gears have several ripples (PHYSICS 6, Masses); of up to two less came than was promised (docs/diagnosis.md)."""

PLAY_ODDS = 0.09
"""[-] Prior odds of a good machine's play. Guards and Reason: as RIPPLE_ODDS."""

NOISE_TRUST = 40.0
"""[-] Rows that the noise model's scale is worth (nu0 of docs/diagnosis.md, eq. 4). Guards: the evidence against a noise
level that still holds an effect. Reason: 40 rows are a scale known to 16 %, which repeats of a campaign tell
(docs/diagnosis.md, Noise)."""

WRONG_SIGN = 2e-4
"""[-] Chance of a sign that physics rules out. Guards: a cell that believes a sign or a mounting wrongly: such a value is to
be named and doubted, not unspeakable. Reason: below any prior odds of an effect at a joint, so that it never decides between
two names."""

JOINT_KERNEL = (2e-5, 5e-4)
"""[rad] Low and high of an unknown error of a joint's angle. Guards: 'none of these'. Reason: about the ranges of the
catalogue's play and gears (docs/effects.md)."""

TILT_KERNEL = (1e-5, 3e-4)
"""[rad] The same of an axis that tilts under load or warmth. Reason: about half of the joints' range, as the catalogue's
thermal and bending effects have it."""

FRAME_KERNEL = (2e-5, 5e-4)
"""[m] The same of a displacement of the instrument's frame or along its beam. Reason: as a joint's at one metre."""

FORCE_KERNEL = (0.2, 5.0)
"""[N] The same of a force reading. Reason: from below a reading's usual noise (0.3 N); waves of 0.05 N are what the ripple makes
that every gear has. No reason known for the upper end."""

# ---------- readings: which count, what they can show
LEAST_READINGS = 20
"""[readings] Of a tracker, measured or planned. Guards: any verdict from too little. Reason: fewer readings than an arm has
parameters to be told by them (three numbers each) tell nothing apart."""

LEAST_CONTACT_ROWS = 20
"""[rows] Of a planned log in contact. Guards: as LEAST_READINGS. Reason: as LEAST_READINGS."""

OUTLIER_WEIGHT = 0.1
"""[-] Probability of being a good reading (of a force reading: its weight of Student's t) below which it is an outlier: of no
gap, no fold and no effect. Guards: gaps and held-out errors against gross readings. Reason: the mixture (2 % outliers 30 times
as wide) leaves hardly a reading between 0.1 and 0.9."""

OUTLIERS_OF_ONE_CAUSE = 3
"""[readings] That must be set aside before all are counted once more, and that an effect must take back. Guards: a nest that
moves before the last few readings, else 'no gap'. Reason: one or two readings are no pattern
(tests/diagnose/test_diagnosis_outliers.py)."""

LEAST_TURN = np.radians(20.0)
"""[rad] An axis that moved less varies with nothing, in kernels, spectra and folds. Reason: over 20 degrees a wave of one
turn is a straight line to 1.5 %, which the geometry follows."""

LEAST_TORQUE = 1.0
"""[N m] Loads that change less bend nothing. Guards: kernels against the rounding of a constant load. Reason: the softest
joint of the catalogue (5e-6 rad/(N m)) turns by half of the usual joint noise (1e-5 rad)."""

SEEN_LAMBDA = 4.0
"""[lambda] At the upper end, below which a variant is no candidate. Guards: against names whose evidence would be their
prior. Reason: two sigma at the largest size that is usual."""

SEEN_DIRECTION = 0.05
"""[-] Whitened length of a kernel's direction below which it is no degree of freedom of its test. Guards: p-values against
directions that unit noise at the upper end of the kernel's size could not show. Reason: below a twentieth of the noise."""

# ---------- search: how far it looks (more only costs time), and
# when it accepts
MOST_SEARCHED = 1000
"""[readings] That are searched; what is found is fitted to all. Guards: minutes. Reason: judgement; lambda grows with the
readings, and what a thousand do not show is mostly below play and ripple (docs/diagnosis.md, 6 and Limits)."""

PAIR_FIRSTS = 30
"""[families] Tried as the first of a pair with every other. Reason: the search's time; the pairs planted in tests/diagnose
are found."""

EXACT_SINGLES, EXACT_PAIRS = 20, 24
"""[sets] Of one and of two that are weighed exactly. Reason: as PAIR_FIRSTS."""

MOST_TELLING = 10
"""[variants] Of a family that are weighed in sets: the most telling alone, and beside what is accepted. Reason: time; a ripple's
eleventh order carries no weight beside the first three lines."""

GROWN = 4
"""[families] Tried to be added to a set, or put in a member's place. Reason: as PAIR_FIRSTS."""

MOST_BACKGROUND = 12
"""[families] Of the background in one set. Reason: two lines in each of six gears."""

BACKGROUND_GAIN = 0.5
"""[ln] That a family of the background must gain to be looked at. Reason: less makes no set likelier than it was."""

GROWN_WITHIN = 8.0
"""[ln] Sets this much below the best are not grown. Guards: true sets that begin badly. Reason: e^-8 is 3 in ten thousand;
what grows from there has to gain that first."""

GROWN_NAMES = 2
"""[sets] Best ones without a kernel that are grown even so. Guards: names against kernels: a kernel must beat the best names
there are. Reason: one and its rival."""

KERNEL_BENEFIT = 8.0
"""[ln] By which a kernel must beat every name to keep it out of the fit. Guards: a true name whose kernel still follows the
noise's excess better. Reason: once fitted both compete again; as GROWN_WITHIN (docs/diagnosis.md, None of these)."""

SEARCHED_IN_VAIN = 3
"""[names] Accepted, after which an arm that still misses far more than noise has its names selected on held-out errors. Guards:
time: what the search would name on measured robots is not used. Reason: up to three huge effects may hide in the noise."""

SHARPER_GAIN = 0.5
"""[ln] That a scanned number between the grid's must gain. Reason: less is below one sigma of that number."""

FAILED_FITS = 2
"""[fits] After which a name that no fit ever held is given up. Guards: minutes, and names at which the contact has no
balance. Reason: once may be for another name's sake."""

HOPELESS_FITS = 3
"""[fits] Diverged one after another, from which on no other name is fitted. Guards: minutes, where the contact that was logged
is not the believed one (a gain of three). Reason: of 38 logs of development none had more than one before a fit that rests."""

RAN_OFF = 1.5
"""[-] Times the squares that the believed contact leaves, above which a fit with names has run off. Guards: a rest at forces that
no contact holds (7.9 N left of 0.9), its noise estimated anew there. Reason: names that are zero leave just as much."""

RECHECKED = 3
"""[families] Tried for readings that were set aside, the most telling first. Reason: time, each is a nonlinear fit."""

# ---------- selection on held-out error: arms that miss far more than noise (docs/diagnosis_real.md)
SELECTED_ON = 2000
"""[readings] That names are selected on. Reason: time."""

SELECTED_FIRST = 2
"""[names] Of the first pass, which leaves the geometry, whose prior is as wide as what it had to follow, narrower. Reason:
what is found first are springs, mostly of two joints (docs/diagnosis_real.md)."""

SHORTLIST = 12
"""[candidates] Of a round that are judged on folds, those that gain most on all readings. Reason: time."""

HELD_OUT_GAIN = 0.02
"""[-] Of the mean log mean square that a further name must gain. Guards: names that hold by chance. Reason: 1 % of the rms;
measured on the UR5 and the UR10 (docs/diagnosis_real.md, eq. 1)."""

HELD_OUT_WORSE = 1.25
"""[-] Mean square of a fold against that of the believed cell above which a candidate is refused. Guards: against names that
follow something else nearby. Reason: 12 % of the rms; measured as HELD_OUT_GAIN."""

WRONG_SIGN_GAIN = 0.15
"""[-] As HELD_OUT_GAIN, more, for a value whose sign no machine has. Guards: as WRONG_SIGN. Reason: then a sign or the
mounting is not as believed, which is said only where much hangs on it (UR5 of which x_dif is turned round,
docs/diagnosis_real.md)."""

WIDE_PRIOR = 3.0
"""[-] Times the upper end of the usual range: one sigma of coefficients there. Reason: the data decide, not the prior; the
same three as IMPLAUSIBLE."""

KERNELS_BESIDE = 6
"""[kernels] That are weighed beside the selected names. Reason: time; one tells where the rest lies."""

# ---------- verdict and probabilities
LEADS = 0.5
"""[-] Probability from which 'none', 'none of these' or a name leads. Guards: the verdicts no_gap and unexplained. Reason:
FORMATS.md."""

EXPLAINED = 0.8
"""[-] Probability of an explanation from which the verdict is 'explained', else 'ambiguous'. Reason: FORMATS.md."""

SUSPECT = 0.75
"""[-] Probability of something outside the catalogue where readings scatter as no such machine does. Guards: rows of two
campaigns under each other, which a fit's noise would hold. Reason: above LEADS, and not certain."""

IMPLAUSIBLE = 3.0
"""[-] Times the upper end of the typical range above which (by IMPLAUSIBLE_SD) a value is doubted. Reason: DIAGNOSIS.md, the
catalogue: implausible means over three times the upper end."""

IMPLAUSIBLE_SD = 2.0
"""[sd] By which such a value must stand above. Reason: 98 % one-sided."""

WRONG_SIGN_SD = 3.0
"""[sd] From which a sign is wrong. Reason: one in a thousand."""

CANCELS = 0.25
"""[-] Of the shorter of two signatures: what both together leave when they cancel. Guards: two terms that overdo each other.
Reason: then three quarters of each are the other's."""

NO_GAP = 0.2
"""[-] Of the noise: a gap below it is none to speak of, and can neither be helped nor hurt. Reason: FORMATS.md."""

MISSED = 0.1
"""[-] Share of data sets in which an effect of the visible size is not named. Reason: named nine times of ten, FORMATS.md."""

# ---------- classes: what data cannot tell apart
TOLD_APART = (10.5, 12.7, 14.2)
"""[lambda] That is told from nothing, for 1, 2, 3 parameters. Reason: noncentral chi-square: a test at one in twenty finds
it nine times in ten (DIAGNOSIS.md)."""

TOLD_APART_MORE = 1.3
"""[lambda] For each further parameter. Reason: the same chi-square, 1.2 for the fourth and less after it, rounded up."""

IMITATED = 0.5
"""[-] Of the signature that an imitator takes at least. Reason: what is hardly there is imitated by anything."""

MOVED = 1e-6
"""[-] Of half the distance between scanned values of a number, by which it is moved for a slope in it. Guards: deviations of what
hangs on such a number, which is no better known than the readings tell it. Reason: a rate moved so far turns a wave of an hour by
less than a hundredth; large beside rounding."""

# ---------- alternatives and shrinkage
FOLLOWED = 0.03
"""[-] Probability below which an alternative is not followed in predictions. Reason: it moves no prediction by more than 3 %
of what the alternatives differ by, nor its sigma by more than 17 %, the square root."""

MOST_FOLLOWED = 5
"""[sets] Alternatives beside the accepted one. Reason: time."""

ONE_COURSE = 0.95
"""[-] Rank correlation of temperature and time from which they are one course. Guards: patches whose promise hangs on which of
the two it was. Reason: of a warm-up the logarithm of time and the temperature are told apart by their curvature alone, which no
kernel knows (creep_under_load of worlds by other hands, patched over temperature: 60 % promised, -3 and 15 % came)."""

MOST_PATCHES = 6
"""[patches] For one gap of tracker readings; of a force log half as many. Reason: a patch a joint; six take a UR5's readings that
were left out to 0.063 mm, three to 0.066; of a log what a third does not hold is no plain function of one or two conditions."""

NEAR = 0.05
"""[-] Of a condition's whole range; an end twice as far from the next readings is left out. Guards: where a patch ends. Reason:
less than any smooth feature's length."""

NEAR_SHARE = 0.01
"""[-] Of all readings: with fewer near an end of a range nothing was measured there. Guards: as NEAR. Reason: even campaigns
have five times as many near their ends; one reading of a hundred, elsewhere in a joint's range, stretched a patch of a UR10 over
what nobody had measured, and a gap of 0.43 mm came out at 0.52 (ur10_two_series)."""

INTERVAL = 0.9
"""[-] Of the shrinkage's interval. Reason: FORMATS.md."""

CARRIED = (1.0, 0.1)
"""[-] Mean and one sigma of the share of what named effects explain that is there again on another day. Guards: promises for
another day of what one campaign taught. Reason: what is learnt on the KR 300's first recording takes as much of the second's gap
as of its own, 84 %, so the share is 1 within 0.16 (docs/diagnosis_real.md)."""

CARRIED_CHOSEN = (0.88, 0.19)
"""[-] The same of names chosen on held-out errors, on arms that miss far more than noise. Guards: as CARRIED. Reason: names
learnt on one of four days of the UR10's grid, on each of the others: 0.88, scattering by 0.19 (docs/diagnosis_real.md)."""

CARRIED_PATCH = (0.95, 0.2)
"""[-] The same of what a patch adds to the names, in any new readings. Guards: promises of patches. Reason: its kernels are the
likeliest of many on the readings that it is fitted to; on fresh machines with an effect outside the catalogue 0.7 to 1.0 came of
what they explained, once twice as much (`benchmarks/other_hand.py`, seeds 1 and 2)."""

NEW_CONDITIONS = 0.25
"""[-] Weight of extrapolation folds among the draws. Guards: the predicted shrinkage where noise is far above usual. Reason:
new readings lie mostly among the old ones; no reason known for a quarter."""

HARMFUL = -1.0
"""[-] A shrinkage below this says no more than 'harmful'. Reason: the gap has doubled."""

NOTHING_UNEXPLAINED = 0.9
"""[-] Probability before the folds that nothing is unexplained. Reason: with UNEXPLAINED_SIZE the promised
INTERVAL covers 0.89 on fresh worlds of development (docs/diagnosis.md, Measured); no reason known for just this pair."""

UNEXPLAINED_SIZE = 0.25
"""[-] Of the noise's mean square: what else is, on average. Reason: as NOTHING_UNEXPLAINED."""

MEASURED_PAYLOAD, UNMEASURED_PAYLOAD = 0.5, 1.0
"""[-] Dirichlet weights of payloads in new readings. Reason: one half is Jeffreys' for an unknown mixture; what is new is
rather a payload that was not measured than one that was."""

LATER = 1.0 / 3.0
"""[-] Of the campaign's duration: how far ahead new readings are thought. Reason: a sealed set is taken soon after; no
reason known for a third."""

LATER_WARMTHS = (0.1, 0.5, 0.9)
"""[-] Quantiles of the campaign's temperatures that new readings are thought at. Reason: cold, usual and warm."""

LEAST_WARMTH = 0.3
"""[K] Less is one temperature. Reason: an arm of 2.5 m in steel grows by 9 um, below a tracker's noise."""

# ---------- location, budget and lists
SHARE_PER_FEATURE = 0.03
"""[-] Of a signature that a condition must explain more for each feature it has more. Reason: many features explain a part
of anything; no reason known for the value."""

PLACE_SURE = 1e-3
"""[-] p-value, the number of kernels allowed for, below which a kernel test names a place. Reason: one in a thousand, as
TOLD_APART."""

BUDGET_SD = 3.0
"""[sd] Of what noise itself scatters: a gap below it is not shared out. Reason: one in a thousand."""

RANKED = 12
"""[names] Told with their values. Reason: readability."""

LISTED = 1e-4
"""[-] Probability below which an effect or explanation is not listed, but for the first. Reason: readability."""

MOST_LISTED = 20
"""[names] Of the ranking in diagnosis.json. Reason: readability."""

LEAST_BUDGET, MOST_BUDGET = 3, 24
"""[lines] Of the budget in diagnosis.json. Reason: readability."""

# ---------- what to measure next
RIVAL = 0.05
"""[-] Probability of an explanation from which it is one to tell apart. Reason: one in twenty; a plan may hang on it."""

ON_TOP = 0.15
"""[-] Probability from which it is asked whether an effect comes on top of the best explanation. Reason: no reason known for
the value; below 1 - EXPLAINED its answer changes no verdict."""

EXPERIMENT_GAIN = 0.02
"""[-] Of probability: an experiment that brings less is not worth its time. Reason: a tenth of what 'explained' leaves open."""

SETTLES = 0.8
"""[-] Probability from which an experiment is said to tell a rival apart beside the one it tells best. Reason: EXPLAINED."""

MOST_EXPERIMENTS, MOST_RIVALS = 5, 6
"""[experiments, pairs] Proposed and looked at. Reason: readability and time."""

UNKNOWN_LOOKED_AT = 0.2
"""[-] Of p_unknown, from which a closer look is proposed where the gap lies. Reason: then nothing else can be EXPLAINED."""

EXPERIMENT_REPEATED = 0.25
"""[-] Of lambda now: what an experiment in words adds to it. Reason: a guess; it moves only part of the signature."""

HIDDEN = 8
"""[effects] That a log leaves unseen and that are looked at, those that it shows best first. Reason: time."""

NAMED_PRICE = 1.7
"""[ln] That evidence pays for a coefficient. Reason: 1/2 log(1 + lambda) at the lambda of 30 or so from which effects are
named."""

# ---------- signal: tracker
USUAL_JOINT_NOISE = 1e-5
"""[rad] Joints' repeatability before the readings are looked at. Guards: how sure a reading is where the residual still holds a
gap. Reason: a KR 210 repeats to 0.06 mm at 2.7 m by its sheet, which is 2e-5 rad of one joint and half of that of several."""

USUAL_JOINT_NOISE_SD = 0.7
"""[-] One sigma of its logarithm. Guards: robots better or worse than usual. Reason: a factor of two either way."""

RESTLESS = 3.5
"""[-] Of the usual joint noise, above which what the residual asks for is a gap, not noise. Guards: an effect that hides in the
noise. Reason: none is known; nearly two of USUAL_JOINT_NOISE_SD."""

UNEVEN = 1.5
"""[-] Times the joint noise of the others, above which readings of one nest, payload, session or stand, or a joint (and RESTLESS)
scatter more. Guards: 'no gap' and names against a nest that flops, which one noise for all holds. Reason: of 81 machines by
other hands with nothing planted none has a group whose p-value is below 0.01, some of few readings have 1.6; a nest that flops by
0.05 mm has 1.7; of 64 with 10 to 30 urad of ripple in every gear no joint has more than 32 urad."""

LEAST_GROUP = 8
"""[readings] Of such a group, and of the others. Guards: as UNEVEN. Reason: 24 numbers, a scatter known to 15 %."""

REPEATED_NOISE_SD = 0.3
"""[-] One sigma of the logarithm of the joint noise where repeats tell it, the scatter of few repeats apart. Guards: as
USUAL_JOINT_NOISE_SD. Reason: repeats in place show less than coming back from afar; by how much nobody knows."""

LEAST_REPEATED = 12
"""[-] Degrees of freedom of repeats from which they tell the joint noise. Guards: as REPEATED_NOISE_SD. Reason: five readings of
one posture, a scatter known to 20 %."""

OUTLIER_SHARE = 0.02
"""[-] Of gross readings among all. Guards: evidence against single readings that are wrong. Reason: none is known; one in
fifty."""

OUTLIER_SIZE = 30.0
"""[-] Of a gross reading against a good one, in sigmas. Guards: as OUTLIER_SHARE. Reason: none is known; a
millimetre or two where readings scatter by hundredths."""

TAILS = np.array([3.0, 5.0, 10.0])
"""[-] Degrees of freedom of Student's t that a tracker's readings may follow. Guards: evidence for a name against the few
readings that a normal law gives all the weight. Reason: air that moves makes such tails; below 3 a reading has no variance, from
10 on tails hardly differ from none."""

TAILS_TOLD = 3.0
"""[ln] By how much readings must speak for tails before they count. Guards: the evidence of normal readings, which stays exact.
Reason: half the logarithm of 400 readings, the price of one more number."""

BELIEVED_SPRING_SD = 0.35
"""[-] Of the compliance of a joint that is believed to bend. Guards: a spring that is off by more is named (joint_compliance).
Reason: none is known; about a third."""

STRAY_SPRINGS = 0.1
"""[-] Share of joints that agree neither with their listed spring nor with none. Guards: whether listed springs belong to the
baseline, against one joint that decides for all. Reason: none is known; one in ten."""

STRAY_COMPLIANCE = 2.5e-6
"""[rad/(N m)] Scale of such joints' compliance. Guards: as STRAY_SPRINGS. Reason: half of the softest joint of the
catalogue."""

RELEARNED_WIDTH = 0.15
"""[-] Of the logarithm of a learned prior's width, below which it stays. Guards: refits for nothing. Reason: a width from some
twenty numbers is known to 15 %."""

LINK_MASS_SD = 0.04
"""[-] Of a link's mass. Guards: payloads and springs that weight tells apart. Reason: catalogue masses are off by 3 to 5 %
(DIAGNOSIS, Second method)."""

LINK_CENTRE_SD = 0.01
"""[m] Of each coordinate of a link's centre of mass. Guards: as LINK_MASS_SD. Reason: catalogue centres are off by 1 cm
(DIAGNOSIS, Second method)."""

WEIGHT_WIDTHS = 0.5 ** np.arange(4)
"""[-] Of both LINK_MASS_SD and LINK_CENTRE_SD on one machine, each as likely before the readings. Guards: promises for a payload
never hung where weights are known better. Reason: even on a logarithmic scale; an eighth is half a
percent of a mass, of which nothing is seen."""

PAYLOAD_MASS_SD = 0.008
"""[-] Of a payload's mass. Guards: payload_mass against what a scale does not tell, promises for a payload never hung. Reason:
payloads are as stated to 1 % (DIAGNOSIS, Second method), which may be a limit or one sigma."""

LEAST_CHANGES = {"temperature_C": 0.3, "time_s": 60.0, "clock_s": 60.0}
"""[K, s] A condition that changes less shows no effect that depends on it. Guards: names of effects that a campaign cannot show.
Reason: 0.3 K of 12 um/(m K) on 2.5 m are a hundredth of a millimetre; a minute is a reading or two."""

FOLD_WARMTH = 1.0
"""[K] Over which temperature must vary for the warmest third to be left out. Guards: folds that extrapolate nothing. Reason:
three times LEAST_CHANGES."""

FOLD_TIME = 600.0
"""[s] The same of time. Guards: as FOLD_WARMTH. Reason: ten minutes, some twenty readings."""

FAR_TURN, FAR_WARMTH = 30.0, 5.0
"""[deg, K] Outside of what was measured, from which a sealed condition is told. Guards: trust in predictions that nothing speaks
for. Reason: even fifty random postures come nearer to an axis' ends; 5 K of 12 um/(m K) on 2.5 m are a tenth of a millimetre."""

FAR_SHARE = 0.25
"""[-] The same of a force log's settings: of the largest, where that is more than they vary by. Guards: as FAR_WARMTH. Reason: a
quarter more is another process."""

OFF_AS_CALIBRATED = 2.0
"""[-] Mean error by the cell's own calibration, of what it told of readings left out of its campaign, above which that is told.
Guards: readings of another arm, or of one that was mastered anew, taken for this cell's. Reason: an arm to which nothing happened
is missed 0.6 to 0.9 times so far, one with an axis mastered anew by 0.4 mrad 3.5 times, another one 9 times."""

NO_BACKGROUND = 0.05
"""[-] Prior probability that a machine has no play at all that lasts, and no ripple. Guards: what a corrected model is promised
to leave. Reason: every gear has ripple (PHYSICS 6, Masses) and a little play (DIAGNOSIS, Second method), of some too little to be
told from none: one in twenty."""

NO_OTHER_RIPPLE = 0.25
"""[-] The same where a name is at stake. Guards: ripples that other gears do not show, which as background would have no name.
Reason: none is known; at 0.05 a ripple of lambda 140 (other_hand_18) is background."""

BACKGROUND_SIZES = np.array([0.0, 1e-6, 2.5e-6, 5e-6, 9e-6, 1.5e-5])
"""[rad] Play and ripple that are looked for in what a fit leaves, evenly likely: each stands for what lies nearest; for a name
all are alike. Guards: as NO_BACKGROUND. Reason: below what the catalogue names (2e-5 of ripple, 3e-5 of play)."""

# ---------- signal: force
STIFFNESS_SD = 0.01
"""[-] Relative: one sigma of the stiffnesses of cover, blade and flange beside the effects that change them. Guards: these
effects: with a calibration's freedom the believed contact would take them away unseen. Reason: the error of the finite elements
and of the wheel's law (docs/diagnosis_force.md, Nuisance or effect)."""

SENSOR_BIAS_SD = 0.02
"""[N] The same of the sensor's zero, beside the effect sensor_bias. Reason: as STIFFNESS_SD; what taring leaves."""

SHEAR_GAIN_SD = 0.03
"""[-] One sigma of the tangential reading's gain. Guards: tangential_force and friction. Reason: it comes from a sensor's second
axis, whose gain and zero are worse known than the first's."""

SHEAR_BIAS_SD = 0.1
"""[N] The same of its zero. Guards and Reason: as SHEAR_GAIN_SD."""

JOINTS_REPEAT = 1e-5
"""[rad] By which each joint comes back to a recording's path, one sigma. Guards: effects that move whole runs against being too
sure: on a rigid mount it makes 0.4 N. Reason: DIAGNOSIS, Second method (within a factor of 2)."""

LOOSE = 0.25
"""[-] Of the force that presses, above which scatter is no noise of a contact. Guards: logs that jump by newtons in ways nothing
makes against 'no gap' and against a name. Reason: at four sigma wheel and blade would part, and a log in contact has thousands
of readings."""

LEAST_DIRECTION = 0.02
"""[-] Whitened length of a direction of the believed contact, one prior sigma, below which it does not count. Guards: evidence
against directions that no reading shows. Reason: a fiftieth of the noise; SEEN_DIRECTION is the kernels'."""

ORDERS_APART = 1.0
"""[rad] Of phase over an axis' range by which two orders of a ripple differ that are both looked at. Guards: prior odds against
copies of one ripple, 'none of these' against half orders that a short range shows as whole ones. Reason: closer ones short ranges
cannot tell apart."""

FAST_SHARE = 0.3
"""[-] Of a signature's squares that averages over blocks lose, from which its pattern is kept beside them. Guards: what is fast
against being seen too weakly. Reason: a runout loses nearly all, what is slow nearly nothing; no reason known for the value."""

FAST_LAMBDA = 10.0
"""[lambda] That is lost at least, at the upper end. Guards: as FAST_SHARE. Reason: below TOLD_APART nothing is told apart."""

TRAINS_OFFERED = 2
"""[trains] Of a belt's splice that are offered of all rates and places. Guards: against names found in noise: every picked row
holds noise that was picked with it. Reason: the true one and its rival."""

WAVES_PICKED = 1
"""[waves] Of each kind that are offered. Guards and Reason: as TRAINS_OFFERED."""

OVERTONES = 3
"""[waves] Waves of a period. Guards: a name against what one wave leaves of a period. Reason: a saw's further ones have a
sixth of its square."""

KNOCKING = 12
"""[waves] Of what knocks. Guards: 'no gap' against knocks that the catalogue does not have. Reason: a knock of a twentieth of its
period has as many that count."""

RUNS_APART = 40
"""[runs] In contact at most, of which waves may have a phase for each. Guards: minutes; in longer logs a hum may be named a
splice. Reason: judgement, each run costs 20 columns; an alias of a hum keeps pace with ever fewer of many runs."""

LEAST_WAVES = 1.5
"""[waves] Over the longest run. Guards: waves against what is merely slow. Reason: slower ones are the smooth functions'."""

FOLD_PARTS = 5
"""[folds] Of pieces of runs and of stretches of the passes. Reason: the usual five."""

FOLD_PIECE = 40
"""[rows] Of a run that stay together in random folds. Guards: interpolation against the sensor's correlated noise. Reason: ten
times the time over which it is correlated (4 samples)."""

FOLD_ROWS = 40
"""[rows] In contact on each side of a fold. Reason: twice LEAST_CONTACT_ROWS."""

FOLD_REST = 1 / 3
"""[-] Of the rows in contact that a fold must leave. Guards: verdicts against folds that judge the many by the few. Reason: no
reason known for a third rather than a half."""

SETPOINT_CHANGED = 0.2
"""[-] Of the force over the same points by which a run must differ to have had another setpoint. Guards: an operator's force
ladder that nobody wrote down against being an error of the cell. Reason: no effect of the usual size moves a whole run by a
fifth (DIAGNOSIS.md)."""

SETPOINT_ALIKE = 0.1
"""[-] Of a force: runs at one setpoint. Reason: half of SETPOINT_CHANGED."""

SETPOINT_SD = 0.1
"""[-] Of the cell's setpoint: one sigma of one that was read off. Guards: effects against a setpoint that is not known. Reason:
as SETPOINT_ALIKE."""

SETPOINT_ROWS = 20
"""[rows] In contact that tell a run's force. Reason: LEAST_CONTACT_ROWS."""

SAME_POINTS = 2e-3
"""[m] Between the middles of two runs over the same points. Reason: below the step from one line of a blade to the next."""

LATER_FORCE = (1.0 / 6.0, 0.5, 5.0 / 6.0)
"""[-] Of the log's span: how far after its end new readings are thought. Reason: the middles of three equal parts of one more
span, drawn alike."""

BETWEEN_RUNS = 0.1
"""[-] Probability that new readings come between the log's own. Reason: sealed readings are rather taken later; no reason known
for a tenth."""

NEW_RECORDINGS = 3.0
"""[recordings] Of the log's lines, setpoints and feeds that new readings are worth: a gap is another one at others. Reason: what
is ground next has few of them, and nobody knows which (worth 6 of 17 the interval covered 0.67 of 39 force worlds of seed 61;
worth 3 it covers 0.74)."""

# ---------- signal: joints
SPRING_SHARE = 0.3
"""[-] One sigma of a spring that the cell states, of its compliance. Guards: a spring that is off by more is named. Reason: as
BELIEVED_SPRING_SD."""

CATALOGUE_SPRING_SD = 2e-6
"""[rad/(N m)] The same of a catalogue's. Guards: as SPRING_SHARE. Reason: the upper end of what joints give."""

CATALOGUE_SPRING_SHARE = 0.5
"""[-] The same as a share of a catalogue's compliance, where that is more. Guards: as SPRING_SHARE, on small arms, whose joints
give fifty times as much. Reason: a catalogue's springs are an order of magnitude, half or twice."""

DRIVE_SD = {"viscous": 2e-4, "dry": 3e-5, "inertia": 1e-4}
"""[s, rad, s^2] Of the drive's own friction and rotor that a recorded motor torque holds, as the gap it feigns. Guards: a delay,
play or scale that is none. Reason: 1e-7 rad/(N m) times 2000 N m s/rad, 300 N m and 1000 kg m^2, as large drives have."""

ENCODER_ACCURACY = np.radians(15.0 / 3600.0)
"""[rad] To which what springs, friction and a delay leave is the encoder's own. Guards: a bent ring that is taken for a gear.
Reason: 5 to 10 arcsec by the sheets of ring encoders, and eccentricity on top."""

LEAST_ENCODER_NOISE = 1e-8
"""[rad] White noise is at least. Guards: recordings without any. Reason: 0.002 arcsec, finer than any encoder."""

RECORDING_FAULT = 8.0
"""[sd] Robust sigmas beyond which a reading is a fault of the recording. Guards: the noise against single wild samples. Reason:
no Gaussian sample among millions."""

LONGEST_DELAY = 0.06
"""[s] Delays are shorter. Guards: rows at the ends of a recording, where the motor's angle a delay ago is not known. Reason: the
catalogue's go up to 0.05 s."""

TORQUE_WINDOW = 0.4
"""[s] Over which recorded torques are smoothed. Guards: springs against the current's ripple, which inertia keeps from the link.
Reason: none is known; a cubic over it keeps the load's own course."""

ANGLE_WINDOW = 0.05
"""[s] Over which motor angles are smoothed. Guards: speeds, and delays with them, against an angle's last digit: 0.001 deg at
1 kHz is 1 deg/s. Reason: none is known; no axis of a large arm follows 20 Hz."""

HOLE, HOLE_ROWS = 0.4, 10
"""[s, steps] Without rows, both, after which a recording begins anew. Guards: friction and gears against speeds that a spline
makes of a hole. Reason: TORQUE_WINDOW; ten lost rows are a spline's business."""

RESTING_SPEED = 0.02
"""[-] Of a joint's top speed, below which its direction is that of the motion before. Guards: play and friction against the noise
of a joint at rest. Reason: none is known."""
