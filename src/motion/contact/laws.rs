//! Adjoint of the solves of the contact law in one step.
//!
//! In order: compression and expansion of an impact, persistent contact, and, if joints arrive at their stops, a solve
//! for the velocities at the end. With y = M^-1 J* p of each,
//!
//! ```text
//! compression     u = J ((v + v_free)/2 + y1)            expansion   u = J ((v + v_free)/2 + y1 + y2), p_n >= e p1_n
//! persistent      u = J (v_free + yh + y3) + target      arriving    u = J (v_free + yh + y4) + target
//! ```
//!
//! where yh is that of the impulses of the impact, p1 + s p2. With connections, M^-1 is that on the connections
//! ([`At::respond`]). The factor s is one unless the impact would increase the
//! kinetic energy; then the energy is conserved, which determines s.

use super::super::scratch::Scratch;
use super::at::{At, Moved};
use super::faults::named;
use super::record::{Laws, StepRecord};
use crate::contact::{Cone, LawCotangents, Limits, Mode, Turning};
use crate::error::Error;
use nalgebra::DVector;
use std::borrow::Cow;

/// Impulses p, their response y = M^-1 J* p, and m = M^-1 times the cotangent of y.
pub(super) struct Response {
    pub p: DVector<f64>,
    pub y: Moved,
    pub m: Moved,
}

/// The cotangents of all solves of a step.
pub(super) struct Chain {
    /// Pairs of `u_bar` and w for velocities u = J w of the law.
    pub evaluations: Vec<(DVector<f64>, Vec<f64>)>,
    pub responses: Vec<Response>,
    /// Of J times the velocities without contacts, and of J v at the start.
    pub of_free: DVector<f64>,
    pub of_start: DVector<f64>,
    /// Of the target that is added to the normal velocity of persistent contact.
    pub of_target: Vec<f64>,
    pub friction: Vec<f64>,
    pub restitution: Vec<f64>,
    /// Of relative changes of the energies of the relaxed law.
    pub energy: Vec<f64>,
}

/// A solve of the law, to rounding in its modes. At a boundary of redundant contacts, these are the modes on stiff
/// springs; the contacts themselves are on springs if their equations are singular without.
struct Solved<'a> {
    cone: Cow<'a, Cone>,
    impulses: DVector<f64>,
    modes: Vec<Mode>,
    c: DVector<f64>,
}

/// An impact.
struct Hit<'a> {
    first: Solved<'a>,
    second: Option<Solved<'a>>,
    /// The factor of expansion, and the impulses p1 + s p2.
    kept: f64,
    all: DVector<f64>,
}

impl Chain {
    /// The cotangents for those of the velocities of the displacement and of the last velocities. `None` without
    /// solves.
    pub fn new(
        at: &mut At<'_>,
        (s, record): (&Scratch<f64>, &StepRecord),
        (of_moving, of_last): (&[f64], &[f64]),
    ) -> Result<Option<Self>, (String, Error)> {
        let (Some(laws), near) = (&record.laws, &record.near[..]) else { return Ok(None) };
        let (cone, m) = (&laws.cone, 3 * near.len());
        let nothing = || DVector::zeros(m);
        let none = vec![0.0; s.v.len()];
        let hit = record.hit.as_ref().map(|hit| Hit::new(laws, &hit.phases, hit.expansion_kept));
        let struck = hit.as_ref().map_or_else(nothing, |hit| hit.all.clone());
        let mut chain = Self {
            evaluations: Vec::new(),
            responses: Vec::new(),
            of_free: nothing(),
            of_start: nothing(),
            of_target: vec![0.0; near.len()],
            friction: vec![0.0; near.len()],
            restitution: vec![0.0; near.len()],
            energy: vec![0.0; near.len()],
        };

        // Persistent contact, and the solve for joints that arrive at their stops.
        let z = at.solve(of_moving);
        let mut of_struck = at.velocities(near, &z.v);
        let mut forces = nothing();
        let (held, of) = if let Some(energies) = &laws.energies {
            let of = cone.linearized_relaxed(&laws.held, &laws.c, energies).cotangents(&of_struck);
            (laws.held.clone(), of.ok_or_else(|| singular(at, near))?)
        } else {
            let held = Solved::new(cone, &laws.held, (&laws.c, Limits::beside(&laws.c)));
            let of = held.cotangents((at, near), &of_struck)?;
            (held.impulses, of)
        };
        let all = &struck + &held;
        let y = at.respond(near, &none, &all);
        chain.evaluations.push((of.velocities.clone(), sum(&record.v_free, &y.v)));
        chain.turn(at, near, &of);
        chain.of_target.iter_mut().enumerate().for_each(|(k, sum)| *sum += of.velocities[3 * k + 2]);
        chain.add(&of);
        forces += &of.velocities;
        if let Some((c, slower)) = &laws.slower {
            let m_held = at.respond(near, of_moving, &of.velocities);
            let y_held = at.respond(near, &none, &held);
            chain.responses.push(Response { p: held, y: y_held, m: m_held });
            let z = at.solve(of_last);
            let bar = at.velocities(near, &z.v);
            let slower = Solved::new(cone, slower, (c, Limits::beside(c)));
            let of = slower.cotangents((at, near), &bar)?;
            let slower = slower.impulses;
            let y = at.respond(near, &none, &(&struck + &slower));
            chain.evaluations.push((of.velocities.clone(), sum(&record.v_free, &y.v)));
            chain.turn(at, near, &of);
            for k in (0..near.len()).filter(|k| !laws.arriving.contains(k)) {
                chain.of_target[k] += of.velocities[3 * k + 2];
            }
            chain.add(&of);
            let m_slower = at.respond(near, of_last, &of.velocities);
            let y_slower = at.respond(near, &none, &slower);
            chain.responses.push(Response { p: slower, y: y_slower, m: m_slower });
            forces += &of.velocities;
            of_struck += bar;
        } else if hit.is_none() {
            let m = at.respond(near, of_moving, &forces);
            chain.responses.push(Response { p: all, y, m });
            chain.of_free += forces;
            return Ok(Some(chain));
        } else {
            let m = at.respond(near, of_moving, &forces);
            let y_held = at.respond(near, &none, &held);
            chain.responses.push(Response { p: held, y: y_held, m });
        }
        chain.of_free += &forces;
        if let Some(hit) = hit {
            of_struck += cone.g.times(&forces);
            let torque = sum(of_moving, of_last);
            chain.through_impact(at, (s, record, laws), &hit, (&torque, forces, of_struck))?;
        }
        Ok(Some(chain))
    }

    /// The impact; `forces` are the cotangents of its velocities J yh, `of_all` those of its impulses.
    fn through_impact(
        &mut self,
        at: &mut At<'_>,
        (s, record, laws): (&Scratch<f64>, &StepRecord, &Laws),
        hit: &Hit<'_>,
        (torque, mut forces, mut of_all): (&[f64], DVector<f64>, DVector<f64>),
    ) -> Result<(), (String, Error)> {
        let (near, cone, none) = (&record.near[..], &laws.cone, vec![0.0; s.v.len()]);
        let middle: Vec<f64> = s.v.iter().zip(&record.v_free).map(|(a, b)| a + laws.part * (b - a)).collect();
        let (y_all, y_first) = (at.respond(near, &none, &hit.all), at.respond(near, &none, &hit.first.impulses));
        let mut of_middle = DVector::zeros(3 * near.len());
        if let (Some(second), true) = (&hit.second, hit.kept < 1.0) {
            // p (u + G p/2) = 0 determines s.
            let change = cone.g.times(&hit.all);
            let along = (&laws.middle + &change).dot(&second.impulses);
            if along == 0.0 {
                return Err(singular(at, near));
            }
            let part = -second.impulses.dot(&of_all) / along;
            let half: Vec<f64> = middle.iter().zip(&y_all.v).map(|(v, y)| v + 0.5 * y).collect();
            self.evaluations.push((&hit.all * part, half));
            of_middle += &hit.all * part;
            forces += &hit.all * (0.5 * part);
            of_all += (&laws.middle + &change) * part;
        }
        let m = at.respond(near, torque, &forces);
        self.responses.push(Response { p: hit.all.clone(), y: y_all, m });
        let mut of_first = of_all.clone();
        let mut forces = DVector::zeros(3 * near.len());
        if let Some(second) = &hit.second {
            let of = second.cotangents((at, near), &(of_all * hit.kept))?;
            let y = at.respond(near, &none, &second.impulses);
            let before = sum(&middle, &y_first.v);
            self.evaluations.push((of.velocities.clone(), sum(&before, &y.v)));
            self.turn(at, near, &of);
            self.add(&of);
            for (k, least) in of.least.iter().enumerate() {
                self.restitution[k] += least * hit.first.impulses[3 * k + 2];
                of_first[3 * k + 2] += least * laws.rebound[k];
            }
            let m = at.respond(near, &none, &of.velocities);
            self.responses.push(Response { p: second.impulses.clone(), y, m });
            of_first += cone.g.times(&of.velocities);
            forces += of.velocities;
        }
        let of = hit.first.cotangents((at, near), &of_first)?;
        self.evaluations.push((of.velocities.clone(), sum(&middle, &y_first.v)));
        self.turn(at, near, &of);
        self.add(&of);
        forces += of.velocities;
        of_middle += &forces;
        let m = at.respond(near, &none, &forces);
        self.responses.push(Response { p: hit.first.impulses.clone(), y: y_first, m });
        self.of_free += &of_middle * laws.part;
        self.of_start += of_middle * (1.0 - laws.part);
        Ok(())
    }

    /// Adds z* dG s of redundant contacts.
    fn turn(&mut self, at: &mut At<'_>, near: &[usize], of: &LawCotangents) {
        let Some(Turning { z, s }) = &of.turning else { return };
        let still = vec![0.0; at.model.nv()];
        let (y, m) = (at.respond(near, &still, s), at.respond(near, &still, z));
        self.evaluations.push((z.clone(), y.v.clone()));
        self.responses.push(Response { p: s.clone(), y, m });
    }

    fn add(&mut self, of: &LawCotangents) {
        self.friction.iter_mut().zip(&of.friction).for_each(|(sum, more)| *sum += more);
        self.energy.iter_mut().zip(&of.energy).for_each(|(sum, more)| *sum += more);
    }
}

impl<'a> Hit<'a> {
    fn new(laws: &'a Laws, phases: &(DVector<f64>, Option<DVector<f64>>), kept: f64) -> Self {
        let (cone, c) = (&laws.cone, &laws.middle);
        let first = Solved::new(cone, &phases.0, (c, Limits::beside(c)));
        let least = laws.rebound.iter().enumerate().map(|(k, e)| e * first.impulses[3 * k + 2].max(0.0)).collect();
        let limits = Limits { least, ..Limits::beside(c) };
        let between = c + cone.g.times(&first.impulses);
        let second = phases.1.as_ref().map(|second| Solved::new(cone, second, (&between, limits)));
        let more = second.iter().map(|second| &second.impulses * kept);
        let all = more.fold(first.impulses.clone(), |sum, more| sum + more);
        Self { first, second, kept, all }
    }
}

impl<'a> Solved<'a> {
    fn new(cone: &'a Cone, p: &DVector<f64>, (c, limits): (&DVector<f64>, Limits)) -> Self {
        let p = cone.polished(p, c, &limits).map_or_else(|| p.clone(), |(p, _)| p);
        let springs = cone.at_boundary(&p, c, &limits);
        let (of, at) = springs.as_ref().map_or((cone, &p), |(springs, p)| (springs, p));
        let modes = of.modes(at, c, &limits);
        let (cone, impulses) = match springs {
            Some((springs, on_springs)) if !cone.linearized(&modes, &p, c).is_regular() => {
                (Cow::Owned(springs), on_springs)
            }
            _ => (Cow::Borrowed(cone), p),
        };
        Self { cone, impulses, modes, c: c.clone() }
    }

    /// The cotangents of the data of the solve for a cotangent `bar` of its impulses.
    fn cotangents(
        &self,
        (at, near): (&At<'_>, &[usize]),
        bar: &DVector<f64>,
    ) -> Result<LawCotangents, (String, Error)> {
        let Self { cone, impulses, modes, c } = self;
        let linear = cone.linearized(modes, impulses, c);
        let of = match cone {
            Cow::Owned(_) => linear.cotangents_of_unique(bar),
            Cow::Borrowed(_) => linear.cotangents(bar),
        };
        of.ok_or_else(|| singular(at, near))
    }
}

fn singular(at: &At<'_>, near: &[usize]) -> (String, Error) {
    let of = named((at.scene, &at.rows.limits), near);
    let expected =
        "contacts whose impulses have a derivative: begin from rows that simulate recorded, or set smoothing";
    (String::new(), Error::argument(of, "impulses without a derivative", expected))
}

fn sum(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}
