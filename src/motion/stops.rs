//! The set-valued torque of one joint: exact Coulomb friction and stops, as a monotone graph of torque against velocity, and the solution of all rows together.
//!
//! In one step from v to v' = v + h a, with bounds that follow from the stops, low = (lower - q)/h and high = (upper - q)/h, the torque r of friction and stops is a point of
//!
//! ```text
//! v' = low        r >= f
//! low < v' < 0    r = f
//! v' = 0          -f <= r <= f
//! 0 < v' < high   r = -f
//! v' = high       r <= -f
//! ```
//!
//! which is the law of J. J. Moreau's time stepping, one row per joint. With (M + N) a = u + r it is a linear complementarity problem with bounds whose matrix is positive definite:
//! the solution is unique. Each row is in one of the five pieces; given the pieces, a is one forward dynamics whose measurement noise locks the rows at v' = low, 0 or high. All rows
//! that contradict their piece move to the neighboring one together, and one by one where that does not reduce their number (block principal pivoting, J. J. Judice and
//! F. M. Pires, Computers and Operations Research 21, 1994, 587-596; single pivots after K. G. Murty end in finitely many).

/// A joint outside of its stops returns with this time constant, s, and between these velocities, rad/s or m/s. It gains speed as slowly: a jump would give energy.
const RETURN: f64 = 0.05;
const AT_LEAST: f64 = 1e-3;
const AT_MOST: f64 = 1.0;

/// The friction and the stops of one degree of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SetValued {
    /// Its index in v, and in q where it has a coordinate of its own.
    pub row: usize,
    pub coordinate: usize,
    /// Coulomb friction, N m or N.
    pub friction: f64,
    /// True if it has stops, and where: infinite where there is none.
    pub stops: bool,
    pub lower: f64,
    pub upper: f64,
}

impl SetValued {
    /// True if the joint is outside of its stops.
    pub fn is_outside(&self, q: &[f64]) -> bool {
        self.stops && !(self.lower..=self.upper).contains(&q[self.coordinate])
    }
}

/// A point of the graph where the velocity is one value and the torque is any of an interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hold {
    Lower,
    Friction,
    Upper,
}

/// The graph of one row in one step: torques between the velocities at which it is vertical, decreasing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Graph {
    count: usize,
    velocities: [f64; 3],
    holds: [Hold; 3],
    torques: [f64; 4],
    /// The derivatives of the bounds by q and v.
    slopes: [[f64; 2]; 2],
}

/// A velocity that bounds a joint, and its derivatives by q and v.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bound {
    pub velocity: f64,
    slopes: [f64; 2],
}

impl Graph {
    /// Of a row at `q` and `v` in a step `h`.
    pub fn new(of: &SetValued, (q, v): (f64, f64), h: f64) -> Self {
        let never = |velocity| Bound { velocity, slopes: [0.0; 2] };
        let (mut low, mut high) = (never(f64::NEG_INFINITY), never(f64::INFINITY));
        if of.stops {
            let (below, above) = (of.lower - q, of.upper - q);
            let touch = |gap: f64| Bound { velocity: gap / h, slopes: [-1.0 / h, 0.0] };
            low = if below > 0.0 { returning(below, v, h) } else { touch(below) };
            high = if above < 0.0 {
                let Bound { velocity, slopes: [by_q, by_v] } = returning(-above, -v, h);
                Bound { velocity: -velocity, slopes: [by_q, by_v] }
            } else {
                touch(above)
            };
        }
        let mut graph = Self::between(low.velocity, high.velocity.max(low.velocity), of.friction);
        graph.slopes = [low.slopes, high.slopes];
        graph
    }

    /// With these bounds on the velocity.
    fn between(low: f64, high: f64, friction: f64) -> Self {
        let mut graph = Self {
            count: 0,
            velocities: [0.0; 3],
            holds: [Hold::Friction; 3],
            torques: [0.0; 4],
            slopes: [[0.0; 2]; 2],
        };
        graph.torques[0] = if low < 0.0 { friction } else { -friction };
        if low > f64::NEG_INFINITY {
            let above = graph.torques[0];
            graph.torques[0] = f64::INFINITY;
            graph.push(low, Hold::Lower, above);
        }
        if friction > 0.0 && low < 0.0 && high > 0.0 {
            graph.push(0.0, Hold::Friction, -friction);
        }
        if high < f64::INFINITY {
            if graph.count > 0 && graph.velocities[graph.count - 1] >= high {
                graph.torques[graph.count] = f64::NEG_INFINITY;
            } else {
                graph.push(high, Hold::Upper, f64::NEG_INFINITY);
            }
        }
        graph
    }

    fn push(&mut self, velocity: f64, hold: Hold, torque_above: f64) {
        self.velocities[self.count] = velocity;
        self.holds[self.count] = hold;
        self.count += 1;
        self.torques[self.count] = torque_above;
    }

    /// The same with another velocity at one of the stops, -e v: that of a rebound, or rest.
    pub fn rebounding(&self, at: usize, (restitution, v): (f64, f64), friction: f64) -> Self {
        let velocity = -restitution * v;
        let stop = |hold: Hold, usual: f64| {
            (0..self.count).find(|&k| self.holds[k] == hold).map_or(usual, |k| self.velocities[k])
        };
        let (mut low, mut high) = (stop(Hold::Lower, f64::NEG_INFINITY), stop(Hold::Upper, f64::INFINITY));
        let at_lower = self.holds[at] == Hold::Lower;
        *(if at_lower { &mut low } else { &mut high }) = velocity;
        let mut graph = Self::between(low, high.max(low), friction);
        graph.slopes = self.slopes;
        graph.slopes[usize::from(!at_lower)] = [0.0, -restitution];
        graph
    }

    /// The derivatives by q and v of the velocity that a row is locked at.
    pub fn slopes(&self, hold: Hold) -> [f64; 2] {
        match hold {
            Hold::Friction => [0.0; 2],
            Hold::Lower => self.slopes[0],
            Hold::Upper => self.slopes[1],
        }
    }

    /// The piece that a row at this velocity begins in; one that moves toward a stop is not yet at it.
    pub fn piece(&self, v: f64) -> Piece {
        let below = (0..self.count).find(|&k| v <= self.velocities[k]).unwrap_or(self.count);
        if below < self.count && v >= self.velocities[below] {
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

    /// The velocity that the row is locked at; none where it moves.
    pub fn velocity(&self, piece: Piece) -> Option<(f64, Hold)> {
        if let Piece::At(k) = piece { Some((self.velocities[k], self.holds[k])) } else { None }
    }

    /// A velocity moved into its piece.
    pub fn within(&self, piece: Piece, v: f64) -> f64 {
        match piece {
            Piece::At(k) => self.velocities[k],
            Piece::Between(k) => {
                let above = if k < self.count { v.min(self.velocities[k]) } else { v };
                if k > 0 { above.max(self.velocities[k - 1]) } else { above }
            }
        }
    }

    /// The torque where the row moves, else zero.
    pub fn torque(&self, piece: Piece) -> f64 {
        if let Piece::Between(k) = piece { self.torques[k] } else { 0.0 }
    }

    /// The piece that a row must change to, if the velocity of one that moves, or the torque of one that is locked, contradicts its own.
    pub fn contradicted(&self, piece: Piece, found: f64, tolerance: f64) -> Option<Piece> {
        match piece {
            Piece::Between(k) => {
                if k < self.count && !(found <= self.velocities[k] + tolerance) {
                    Some(Piece::At(k))
                } else if k > 0 && !(found >= self.velocities[k - 1] - tolerance) {
                    Some(Piece::At(k - 1))
                } else {
                    None
                }
            }
            Piece::At(k) => {
                if !(found <= self.torques[k] + tolerance) {
                    Some(Piece::Between(k))
                } else if !(found >= self.torques[k + 1] - tolerance) {
                    Some(Piece::Between(k + 1))
                } else {
                    None
                }
            }
        }
    }
}

/// The velocity of a joint that is outside of its lower stop by `outside`, at the end of a step from velocity `v`.
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

/// A piece of a graph: one of the velocities where it is vertical, or what lies below the k-th of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Piece {
    At(usize),
    Between(usize),
}

/// Block moves without fewer contradictions, before single ones.
const PATIENCE: usize = 6;

/// Changes pieces until none is contradicted; `contradictions` lists what each would have to change to, in increasing order of rows. False where there is no solution, which only
/// an indefinite mass matrix allows: rows that contradict both of two pieces are then locked.
pub(super) fn settle(pieces: &mut [Piece], mut contradictions: impl FnMut(&[Piece], &mut Vec<(usize, Piece)>)) -> bool {
    let (mut fewest, mut patience) = (usize::MAX, PATIENCE);
    let mut found = Vec::new();
    let mut before = None;
    for _ in 0..100 + 20 * pieces.len() {
        found.clear();
        contradictions(pieces, &mut found);
        let Some(&(row, piece)) = found.last() else { return true };
        if found.len() < fewest {
            (fewest, patience) = (found.len(), PATIENCE);
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
