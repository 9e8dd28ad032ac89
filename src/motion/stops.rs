//! The set-valued torque of one joint: exact Coulomb friction, stops and a control law with limits of effort as a
//! monotone graph of torque over velocity, and the solution for all rows together.
//!
//! In one step from v to v' = v + h a, with the velocity bounds of the stops, low = (lower - q)/h and high = (upper -
//! q)/h, the torque r of friction and stops is a point of
//!
//! ```text
//! v' = low        r >= f
//! low < v' < 0    r = f
//! v' = 0          -f <= r <= f
//! 0 < v' < high   r = -f
//! v' = high       r <= -f
//! ```
//!
//! A control law adds its torque clip(c - b v', lower, upper), which decreases between two further velocities.
//!
//! This is the law of J. J. Moreau's time stepping, one row per joint. With (M + N) a = u + r it is a linear
//! complementarity problem with bounds whose matrix is positive definite, so that the solution is unique. Each row is
//! on one of the pieces. For given pieces, a is one forward dynamics whose measurement noise makes the rows with
//! v' = low, 0 or high stuck; those on the slope of a control law have the noise h b. All rows that contradict their
//! piece move to the adjacent one together, or one by one if that does not reduce their number (block principal
//! pivoting, J. J. Judice and F. M. Pires, Computers and Operations Research 21, 1994, 587-596; the single pivots of K.
//! G. Murty terminate).

/// A joint outside of its stops returns with this time constant, s, at a velocity between these bounds, rad/s or m/s.
/// The velocity increases as slowly, because a jump would add energy.
const RETURN: f64 = 0.05;
const AT_LEAST: f64 = 1e-3;
pub(super) const AT_MOST: f64 = 1.0;

/// (q, v).
type State<'a> = (&'a [f64], &'a [f64]);

/// The friction, the stops and the control law of one degree of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SetValued {
    /// Index in v, and index of its coordinate in q.
    pub row: usize,
    pub coordinate: usize,
    /// Dry friction against motion in the negative and in the positive direction, N m or N.
    pub friction: [f64; 2],
    /// True if it has stops, and the limits; infinite if there is none.
    pub stops: bool,
    pub lower: f64,
    pub upper: f64,
    /// True if its control law has limits of effort.
    pub drives: bool,
}

impl SetValued {
    /// True if friction acts on the joint.
    pub fn rubs(&self) -> bool {
        self.rubbing() > 0.0
    }

    /// The larger friction of the two directions.
    pub fn rubbing(&self) -> f64 {
        self.friction[0].max(self.friction[1])
    }

    /// True if the joint is outside of its stops.
    pub fn is_outside(&self, q: &[f64]) -> bool {
        self.stops && !(self.lower..=self.upper).contains(&q[self.coordinate])
    }

    /// The distance of the joint from its nearer stop, positive outside.
    pub fn beyond(&self, q: &[f64]) -> f64 {
        (self.lower - q[self.coordinate]).max(q[self.coordinate] - self.upper)
    }

    /// True if the joint is within its stops by a rounding error: the shortest substeps do not move it to the stop.
    pub fn grazes(&self, q: &[f64]) -> bool {
        let (beyond, q) = (self.beyond(q), q[self.coordinate]);
        self.stops && (-4.0 * f64::EPSILON * q.abs()..0.0).contains(&beyond)
    }

    /// True if friction or a stop acts on the joint at the start of a step.
    pub fn holds(&self, q: &[f64], v: &[f64]) -> bool {
        (self.rubs() && v[self.row] == 0.0) || (self.stops && self.beyond(q) >= 0.0)
    }

    /// The velocity bounds of the stops at `q` and `v` in a step h.
    pub fn bounds(&self, (q, v): (f64, f64), h: f64) -> [Bound; 2] {
        let never = |velocity| Bound { velocity, slopes: [0.0; 2] };
        if !self.stops {
            return [never(f64::NEG_INFINITY), never(f64::INFINITY)];
        }
        let (below, above) = (self.lower - q, self.upper - q);
        let touch = |gap: f64| Bound { velocity: gap / h, slopes: [-1.0 / h, 0.0] };
        let high = if above < 0.0 {
            let Bound { velocity, slopes: [by_q, by_v] } = returning(-above, -v, h);
            Bound { velocity: -velocity, slopes: [by_q, by_v] }
        } else {
            touch(above)
        };
        [if below > 0.0 { returning(below, v, h) } else { touch(below) }, high]
    }

    /// The cubic interpolant of a step of length h from (q, v) to `(q_next, v_next)`: a, b, c, d of a + b x + c x^2 + d
    /// x^3, and the coordinate at its end, x = 1.
    fn interpolant(&self, (q, v): State<'_>, (q_next, v_next): State<'_>, h: f64) -> ([f64; 4], f64) {
        let (start, end) = (q[self.coordinate], q_next[self.coordinate]);
        let (slope, last) = (h * v[self.row], h * v_next[self.row]);
        let (c, d) = (3.0 * (end - start) - 2.0 * slope - last, slope + last - 2.0 * (end - start));
        ([start, slope, c, d], end)
    }

    /// True if the cubic interpolant of a step of length h passes a stop within the step, or is so near to one that its
    /// error of fourth order can hide it.
    pub fn passes(&self, from: State<'_>, to: State<'_>, h: f64) -> bool {
        const ERROR: f64 = 1.0 / 16.0;
        let ([start, slope, b, c], end) = self.interpolant(from, to, h);
        // The extrema are at x = r/(3 c) and slope/r.
        let r = -(b + (b * b - 3.0 * c * slope).sqrt().copysign(b));
        self.stops
            && [r / (3.0 * c), slope / r].into_iter().filter(|x| 0.0 < *x && *x < 1.0).any(|x| {
                let extreme = start + x * (slope + x * (b + x * c));
                let error = ERROR * (extreme - start).abs().min((extreme - end).abs());
                extreme - error < self.lower || extreme + error > self.upper
            })
    }

    /// The part of a step of length h in which the cubic interpolant stays within the stops and does not reverse where
    /// friction acts; 1 if it does to the end.
    pub fn keeps(&self, from: State<'_>, to: State<'_>, h: f64) -> f64 {
        let ([start, slope, b, c], _) = self.interpolant(from, to, h);
        let leaves = |x: f64| {
            let (position, rate) = (start + x * (slope + x * (b + x * c)), slope + x * (2.0 * b + 3.0 * x * c));
            let passes = self.stops && !(self.lower..=self.upper).contains(&position);
            passes || self.rubs() && rate * slope < 0.0
        };
        if !leaves(1.0) || leaves(0.0) {
            return 1.0;
        }
        let (mut within, mut beyond) = (0.0, 1.0);
        for _ in 0..40 {
            let middle = 0.5 * (within + beyond);
            *(if leaves(middle) { &mut beyond } else { &mut within }) = middle;
        }
        within
    }
}

/// The kind of a vertical piece of the graph, on which the velocity is fixed and the torque is in an interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hold {
    Lower,
    Friction,
    Upper,
}

/// The torque of a control law over the velocity at the end of a step: offset - slope v' between its lower and upper
/// limits, each of which is constant, declines with v', or is zero, whichever is between the others.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drive {
    pub offset: f64,
    pub slope: f64,
    pub limits: [[Line; 3]; 2],
}

impl Drive {
    /// The torque at velocity v.
    pub fn torque(&self, v: f64) -> f64 {
        self.line(v).at(v)
    }

    /// The law without limits.
    fn law(&self) -> Line {
        Line { torque: self.offset, slope: self.slope, is_limit: false }
    }

    /// The velocities at which the torque can change its piece, in any order; not finite if there are fewer.
    fn kinks(&self) -> impl Iterator<Item = f64> {
        let meets = |a: Line, b: Line| (a.torque - b.torque) / (a.slope - b.slope);
        let law = self.law();
        let of_limit = move |[constant, declining, zero]: [Line; 3]| {
            [(law, constant), (law, declining), (law, zero), (declining, constant), (declining, zero)]
        };
        self.limits.into_iter().flat_map(of_limit).map(move |(a, b)| meets(a, b))
    }

    /// Its torque around velocity v.
    fn line(&self, v: f64) -> Line {
        let limit = |i: usize| {
            let [constant, declining, zero] = self.limits[i];
            let away = |line: Line| [-1.0, 1.0][i] * line.at(v);
            if away(declining) >= away(constant) {
                constant
            } else if away(declining) >= away(zero) {
                declining
            } else {
                zero
            }
        };
        let ([lower, upper], law) = ([0, 1].map(limit), self.law());
        match law.at(v) {
            torque if torque >= upper.at(v) => upper,
            torque if torque <= lower.at(v) => lower,
            _ => law,
        }
    }
}

/// The torque of a control law on one of its pieces, torque - slope v'.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Line {
    pub torque: f64,
    pub slope: f64,
    pub is_limit: bool,
}

impl Line {
    pub fn at(&self, v: f64) -> f64 {
        self.torque - self.slope * v
    }
}

/// Largest number of velocities at which a graph changes its piece.
const KNOTS: usize = 13;

/// The graph of one row in one step: the velocities of its vertical pieces and kinks, in increasing order, and the
/// torques of friction and stops between them, which decrease.
#[derive(Debug, Clone, Copy)]
pub(super) struct Graph {
    count: usize,
    velocities: [f64; KNOTS],
    /// `None` for the kinks of the control law.
    holds: [Option<Hold>; KNOTS],
    torques: [f64; KNOTS + 1],
    /// The control law, and its torque between the velocities.
    drive: Option<Drive>,
    lines: [Line; KNOTS + 1],
    /// Derivatives of the velocity bounds by q and v.
    slopes: [[f64; 2]; 2],
    /// As in [`SetValued`].
    pub friction: [f64; 2],
}

/// A velocity bound of a joint, with its derivatives by q and v.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bound {
    pub velocity: f64,
    pub slopes: [f64; 2],
}

impl Graph {
    /// The graph of a row at `q` and `v` in a step `h`.
    pub fn new(of: &SetValued, state: (f64, f64), h: f64, drive: Option<Drive>) -> Self {
        let [low, high] = of.bounds(state, h);
        let mut graph = Self::between(low.velocity, high.velocity.max(low.velocity), of.friction, drive);
        graph.slopes = [low.slopes, high.slopes];
        graph
    }

    /// The graph with the given velocity bounds.
    pub fn between(low: f64, high: f64, friction: [f64; 2], drive: Option<Drive>) -> Self {
        let mut graph = Self {
            count: 0,
            velocities: [0.0; KNOTS],
            holds: [None; KNOTS],
            torques: [0.0; KNOTS + 1],
            drive: None,
            lines: [Line::default(); KNOTS + 1],
            slopes: [[0.0; 2]; 2],
            friction,
        };
        let [back, ahead] = friction;
        graph.torques[0] = if low < 0.0 { back } else { -ahead };
        if low > f64::NEG_INFINITY {
            let above = graph.torques[0];
            graph.torques[0] = f64::INFINITY;
            graph.push(low, Some(Hold::Lower), above);
        }
        if back + ahead > 0.0 && low < 0.0 && high > 0.0 {
            graph.push(0.0, Some(Hold::Friction), -ahead);
        }
        if high < f64::INFINITY {
            if graph.count > 0 && graph.velocities[graph.count - 1] >= high {
                graph.torques[graph.count] = f64::NEG_INFINITY;
            } else {
                graph.push(high, Some(Hold::Upper), f64::NEG_INFINITY);
            }
        }
        drive.map_or(graph, |drive| graph.driven(drive))
    }

    fn push(&mut self, velocity: f64, hold: Option<Hold>, torque_above: f64) {
        self.velocities[self.count] = velocity;
        self.holds[self.count] = hold;
        self.count += 1;
        self.torques[self.count] = torque_above;
    }

    /// The same graph with a control law.
    fn driven(&self, drive: Drive) -> Self {
        let own = &self.velocities[..self.count];
        // A kink at a vertical piece, or beyond a stop, is no velocity of its own.
        let [first, last] = [self.torques[0], self.torques[self.count]].map(f64::is_infinite);
        let within = |v: &f64| {
            let inside =
                (!first || own.first().is_none_or(|low| v > low)) && (!last || own.last().is_none_or(|high| v < high));
            v.is_finite() && inside && !own.contains(v)
        };
        let mut knots: Vec<(f64, Option<Hold>)> = drive.kinks().filter(within).map(|v| (v, None)).collect();
        knots.sort_by(|a, b| a.0.total_cmp(&b.0));
        knots.dedup();
        // Where the law is not the nearest piece, kinks of its limits are none.
        let middle = |k: usize| match k {
            0 => knots.first().map_or(0.0, |(v, _)| v - 1.0 - v.abs()),
            k => knots.get(k).map_or(knots[k - 1].0 + 1.0 + knots[k - 1].0.abs(), |(v, _)| 0.5 * (v + knots[k - 1].0)),
        };
        let lines: Vec<Line> = (0..=knots.len()).map(|k| drive.line(middle(k))).collect();
        let mut k = 0;
        knots.retain(|_| {
            k += 1;
            lines[k - 1] != lines[k]
        });
        knots.extend(own.iter().copied().zip(self.holds));
        knots.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut graph = Self { count: 0, drive: Some(drive), ..*self };
        for (k, &(v, hold)) in knots.iter().enumerate() {
            let next = knots.get(k + 1).map_or(v + 1.0 + v.abs(), |(next, _)| 0.5 * (v + next));
            graph.push(v, hold, self.torques[own.iter().filter(|own| **own <= v).count()]);
            graph.lines[k + 1] = drive.line(next);
        }
        let before = knots.first().map_or(0.0, |(v, _)| v - 1.0 - v.abs());
        graph.lines[0] = drive.line(before);
        graph
    }

    /// The graph with another velocity at one of the stops: -e v for a rebound, or zero.
    pub fn rebounding(&self, at: usize, (restitution, v): (f64, f64)) -> Self {
        let velocity = -restitution * v;
        let stop = |hold: Hold, usual: f64| {
            (0..self.count).find(|&k| self.holds[k] == Some(hold)).map_or(usual, |k| self.velocities[k])
        };
        let (mut low, mut high) = (stop(Hold::Lower, f64::NEG_INFINITY), stop(Hold::Upper, f64::INFINITY));
        let at_lower = self.holds[at] == Some(Hold::Lower);
        *(if at_lower { &mut low } else { &mut high }) = velocity;
        let mut graph = Self::between(low, high.max(low), self.friction, self.drive);
        graph.slopes = self.slopes;
        graph.slopes[usize::from(!at_lower)] = [0.0, -restitution];
        graph
    }

    /// Derivatives by q and v of the velocity of a stuck row.
    pub fn slopes(&self, hold: Hold) -> [f64; 2] {
        match hold {
            Hold::Friction => [0.0; 2],
            Hold::Lower => self.slopes[0],
            Hold::Upper => self.slopes[1],
        }
    }

    /// The initial piece of a row with velocity v. A row that moves toward a stop is not on the piece of the stop.
    pub fn piece(&self, v: f64) -> Piece {
        let below = (0..self.count).find(|&k| v <= self.velocities[k]).unwrap_or(self.count);
        if below < self.count && v >= self.velocities[below] && self.holds[below].is_some() {
            return Piece::At(below);
        }
        let finite = |k: usize| self.torques[k].is_finite();
        match below {
            k if finite(k) => Piece::Between(k),
            0 if finite(1) => Piece::Between(1),
            k if k > 0 && finite(k - 1) => Piece::Between(k - 1),
            _ => Piece::At(0),
        }
    }

    /// The velocity of a stuck row; `None` if the row moves.
    pub fn velocity(&self, piece: Piece) -> Option<(f64, Hold)> {
        if let Piece::At(k) = piece { self.holds[k].map(|hold| (self.velocities[k], hold)) } else { None }
    }

    /// The torque of the control law on a piece; that of a stuck row is constant.
    pub fn line(&self, piece: Piece) -> Line {
        match piece {
            Piece::Between(k) => self.lines[k],
            Piece::At(k) => {
                let torque = self.drive.map_or(0.0, |drive| drive.torque(self.velocities[k]));
                Line { torque, ..Line::default() }
            }
        }
    }

    /// The velocity v, clipped to its piece.
    pub fn within(&self, piece: Piece, v: f64) -> f64 {
        match piece {
            Piece::At(k) => self.velocities[k],
            Piece::Between(k) => {
                let above = if k < self.count { v.min(self.velocities[k]) } else { v };
                if k > 0 { above.max(self.velocities[k - 1]) } else { above }
            }
        }
    }

    /// The torque of friction and stops of a moving row; zero for a stuck one.
    pub fn torque(&self, piece: Piece) -> f64 {
        if let Piece::Between(k) = piece { self.torques[k] } else { 0.0 }
    }

    /// The piece to which a row must change if the velocity of a moving row, or the torque of a stuck row, contradicts
    /// its piece. `slow` is the tolerance of velocities and `weak` that of torques.
    pub fn contradicted(&self, piece: Piece, found: f64, [slow, weak]: [f64; 2]) -> Option<Piece> {
        // At a kink, the error of the torque is the slope times that of the velocity.
        let near = |k: usize| match self.holds[k] {
            Some(_) => slow,
            None => slow
                .min(weak / self.lines[k].slope.max(self.lines[k + 1].slope))
                .max(f64::EPSILON * self.velocities[k].abs()),
        };
        let beyond = |k: usize, next: usize| if self.holds[k].is_some() { Piece::At(k) } else { Piece::Between(next) };
        let torque = |k: usize, v: f64| self.torques[k] + self.lines[k].at(v);
        match piece {
            Piece::Between(k) => {
                if k < self.count && !(found <= self.velocities[k] + near(k)) {
                    Some(beyond(k, k + 1))
                } else if k > 0 && !(found >= self.velocities[k - 1] - near(k - 1)) {
                    Some(beyond(k - 1, k - 1))
                } else {
                    None
                }
            }
            Piece::At(k) => {
                if !(found <= torque(k, self.velocities[k]) + weak) {
                    Some(Piece::Between(k))
                } else if !(found >= torque(k + 1, self.velocities[k]) - weak) {
                    Some(Piece::Between(k + 1))
                } else {
                    None
                }
            }
        }
    }
}

/// Velocity, at the end of a step, of a joint that is outside of its lower stop by `outside` and begins with velocity
/// `v`.
pub(super) fn returning(outside: f64, v: f64, h: f64) -> Bound {
    let wanted = (outside / RETURN).clamp(AT_LEAST, AT_MOST);
    let by_q = if wanted > AT_LEAST && wanted < AT_MOST { -1.0 / RETURN } else { 0.0 };
    let reached = v.max(0.0) + h * wanted / RETURN;
    let by_v = if v > 0.0 { 1.0 } else { 0.0 };
    let choices = [
        Bound { velocity: wanted, slopes: [by_q, 0.0] },
        Bound { velocity: reached, slopes: [h * by_q / RETURN, by_v] },
        Bound { velocity: outside / h, slopes: [-1.0 / h, 0.0] },
    ];
    let [first, others @ ..] = choices;
    others.into_iter().fold(first, |least, other| if other.velocity < least.velocity { other } else { least })
}

/// A piece of a graph: the vertical piece k, or the horizontal piece below it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Piece {
    At(usize),
    Between(usize),
}

/// Number of block moves without fewer contradictions before single moves begin.
const BLOCK_ROUNDS: usize = 6;

/// Changes pieces until none is contradicted. `contradictions` lists the rows that must change, with the new piece, in
/// increasing order of rows. Returns false if there is no solution, which requires an indefinite mass matrix; rows that
/// contradict two adjacent pieces are then stuck.
pub(super) fn settle(pieces: &mut [Piece], mut contradictions: impl FnMut(&[Piece], &mut Vec<(usize, Piece)>)) -> bool {
    let (mut fewest, mut patience) = (usize::MAX, BLOCK_ROUNDS);
    let mut found = Vec::new();
    let mut before = None;
    for _ in 0..100 + 20 * pieces.len() {
        found.clear();
        contradictions(pieces, &mut found);
        let Some(&(row, piece)) = found.last() else { return true };
        if found.len() < fewest {
            (fewest, patience) = (found.len(), BLOCK_ROUNDS);
        } else {
            patience = patience.saturating_sub(1);
        }
        if patience > 0 {
            for &(at, piece) in &found {
                pieces[at] = piece;
            }
            continue;
        }
        if before == Some((row, piece)) {
            break;
        }
        before = Some((row, pieces[row]));
        pieces[row] = piece;
    }
    for _ in 0..pieces.len() {
        found.retain(|(_, piece)| matches!(piece, Piece::At(_)));
        if found.is_empty() {
            break;
        }
        for &(at, piece) in &found {
            pieces[at] = piece;
        }
        found.clear();
        contradictions(pieces, &mut found);
    }
    false
}

#[cfg(test)]
mod tests;
