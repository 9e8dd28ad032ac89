//! A scene with its [limbs side by side](super::limbs): fewer bodies, in each lane the numbers of another limb.

use super::body::{Carrier, LeanBody, LeanModel, Turning, interleaved};
use super::frames::Framed;
use super::limbs::{ABREAST, Bundle, bundles};
use super::scratch::LeanScratch;
use super::segment::{OfSegment, Segment, segments};
use super::slide::Slide;
use super::slots::{Ordered, last_children};
use super::tilt::{Axle, Tilt};
use crate::filter::Stage;
use crate::filter::cancellation::weight;
use crate::scalar::{Limbs, Real};
use crate::scene::{Body, Model};

/// Where the number of each lane is among the numbers of the state.
pub(crate) type Places = [usize; ABREAST];

/// The scene, its scratch, and where its numbers are in a state's.
#[derive(Debug)]
pub(crate) struct Abreast {
    pub model: Model<Limbs>,
    pub lean: LeanModel<Limbs>,
    pub scratch: LeanScratch<Limbs>,
    /// Of each coordinate.
    pub coordinates: Vec<Places>,
    /// Of each row.
    pub rows: Vec<Places>,
    /// Of each body.
    pub bodies: Vec<Places>,
    /// Row and lane of each row of the state.
    pub of_state: Vec<(usize, usize)>,
}

impl Bundle {
    /// The body of a lane: of one that has none, the first, to have numbers there.
    fn body(&self, lane: usize) -> usize {
        self.bodies.get(lane).copied().flatten().unwrap_or_else(|| self.first())
    }
}

impl Abreast {
    /// None where too few bodies go side by side to be worth it.
    pub fn of(model: &Model<f64>) -> Option<Self> {
        let bundles = bundles(model, &Framed::of(model));
        // What is gained is a body's time for each that another takes along; what it costs, wider moves for all.
        if bundles.len() * 5 > model.bodies.len() * 3 {
            return None;
        }
        // Lanes without such a body have nothing on the one that it hangs on, which then needs inertia of its own.
        let is_ragged = bundles.iter().any(|bundle| bundle.bodies.iter().any(Option::is_none));
        if is_ragged && model.bodies.iter().any(|body| body.inertia.mass == 0.0) {
            return None;
        }
        let bodies: Vec<Places> = bundles.iter().map(places_of).collect();
        let first = first_of_each(model, &bundles);
        let mut abreast = first.cast::<Limbs>();
        let lean = in_lanes(model, &first, &bundles);
        let (mut coordinates, mut rows, mut of_state) = (Vec::new(), Vec::new(), vec![(0, 0); model.nv()]);
        for (bundle, places) in bundles.iter().zip(&bodies) {
            let motion = model.bodies[places[0]].motion;
            let (q, row) = (places.map(|k| model.bodies[k].q), places.map(|k| model.system.stages[k].first_row));
            coordinates.extend((0..motion.nq()).map(|i| q.map(|q| q + i)));
            for i in 0..motion.rows().count() {
                for lane in (0..bundle.bodies.len()).filter(|&lane| bundle.bodies[lane].is_some()) {
                    of_state[row[lane] + i] = (rows.len(), lane);
                }
                rows.push(row.map(|row| row + i));
            }
        }
        let mut scratch = LeanScratch::new(&abreast, &lean);
        for (i, places) in rows.iter().enumerate() {
            for (lane, &row) in places.iter().enumerate() {
                abreast.system.noise[i].lanes_mut()[lane] = model.system.noise[row];
                scratch.watching.weights[i].lanes_mut()[lane] = weight(row);
            }
        }
        Some(Self { model: abreast, lean, scratch, coordinates, rows, bodies, of_state })
    }
}

/// The scene of the first body of every bundle.
fn first_of_each(model: &Model<f64>, bundles: &[Bundle]) -> Model<f64> {
    let mut first = Model::empty(model.gravity, model.omissions);
    for bundle in bundles {
        let (body, stage) = (model.bodies[bundle.first()], model.system.stages[bundle.first()]);
        let first_row = first.nv();
        first.system.stages.push(Stage { parent: bundle.parent, first_row, ..stage });
        first.system.noise.extend((0..stage.rows.count()).map(|i| model.system.noise[stage.first_row + i]));
        first.bodies.push(Body { q: first.nq, ..body });
        first.inertia_roots.push(None);
        first.nq += body.motion.nq();
    }
    first
}

/// The bodies of each lane.
fn places_of(bundle: &Bundle) -> Places {
    std::array::from_fn(|lane| bundle.body(lane))
}

/// The turns of these bodies, a lane each. Where only some have an offset, that of the others is that of no angle.
fn turning_of(whole: &LeanModel<Limbs>, bodies: &Places, (q, place): (usize, usize)) -> Turning<Limbs> {
    let none = [0.0, 1.0].map(Limbs::from_f64);
    let of_lane = |lane: usize| whole.turning.iter().find(|turning| turning.place == whole.at[bodies[lane]]);
    let mut all = Turning { q, place, sense: none[1], offset: None };
    for lane in 0..ABREAST {
        let Some(own) = of_lane(lane) else { continue };
        all.sense.take_limb(lane, &own.sense);
        if let Some([own_s, own_c]) = own.offset {
            let [s, c] = all.offset.get_or_insert(none);
            s.take_limb(lane, &own_s);
            c.take_limb(lane, &own_c);
        }
    }
    all
}

/// One lane of these numbers becomes that of others.
fn take_lane<'a, 'b>(
    lane: usize,
    numbers: impl Iterator<Item = &'a mut Limbs>,
    others: impl Iterator<Item = &'b mut Limbs>,
) {
    for (number, other) in numbers.zip(others) {
        number.take_limb(lane, other);
    }
}

/// What each of these bodies has, in its lane: of those that have it.
fn in_each_lane<X>(
    bodies: &Places,
    mut all: X,
    of: impl Fn(usize) -> Option<X>,
    take: impl Fn(usize, &mut X, &mut X),
) -> X {
    for (lane, &body) in bodies.iter().enumerate() {
        if let Some(mut own) = of(body) {
            take(lane, &mut all, &mut own);
        }
    }
    all
}

/// The tilts of these bodies, a lane each: the first one's is at `first`.
fn tilt_of(whole: &LeanModel<Limbs>, bodies: &Places, first: usize) -> Tilt<Limbs> {
    let of = |body: usize| match whole.bodies[body].carrier {
        Carrier::Turn(Axle::Tilted(at)) => Some(whole.tilts[at]),
        _ => None,
    };
    in_each_lane(bodies, whole.tilts[first], of, |lane, all, own| take_lane(lane, all.numbers_mut(), own.numbers_mut()))
}

/// How these bodies slide, a lane each: the first one does as at `first`. An angle that only some have is none in the others.
fn slide_of(whole: &LeanModel<Limbs>, bodies: &Places, first: usize) -> Slide<Limbs> {
    let of = |body: usize| whole.bodies[body].slide.map(|at| whole.slides[at]);
    in_each_lane(bodies, whole.slides[first], of, |lane, all, own| {
        take_lane(lane, all.numbers_mut(), own.numbers_mut());
        (all.turns, all.tilts) = (all.turns || own.turns, all.tilts || own.tilts);
    })
}

/// What shifts these bodies, a lane each: the first one's is at `first`, their coordinates begin at `q`.
fn shift_of(whole: &LeanModel<Limbs>, bodies: &Places, (first, q): (usize, usize)) -> Body<Limbs> {
    let of = |body: usize| match whole.bodies[body].carrier {
        Carrier::Shift(at) => Some(whole.shifting[at]),
        Carrier::Turn(_) => None,
    };
    in_each_lane(bodies, Body { q, ..whole.shifting[first] }, of, |lane, all, own| {
        take_lane(lane, all.tree.rotation.iter_mut(), own.tree.rotation.iter_mut());
        take_lane(lane, all.tree.lever.iter_mut(), own.tree.lever.iter_mut());
    })
}

/// The bodies of `model` in the lanes of those of `first`.
fn in_lanes(model: &Model<f64>, first: &Model<f64>, bundles: &[Bundle]) -> LeanModel<Limbs> {
    let whole = LeanModel::<Limbs>::new(model);
    let (mut tilts, mut slides) = (Vec::new(), Vec::new());
    let parents: Vec<_> = bundles.iter().map(|bundle| bundle.parent).collect();
    let order = interleaved(&parents, |k| k);
    let (swept, last_child) = (Ordered::new(&parents, &order), last_children(&parents));
    let (mut shifting, mut turning) = (Vec::new(), Vec::new());
    let (mut bodies, mut roots) = (Vec::with_capacity(bundles.len()), Vec::with_capacity(bundles.len()));
    for (k, bundle) in bundles.iter().enumerate() {
        let of_lane = |lane: usize| &whole.bodies[bundle.body(lane)];
        let mut body = LeanBody {
            index: k,
            parent: bundle.parent,
            row: first.system.stages[k].first_row,
            places: swept.places[k],
            limbs: match bundle.parent {
                Some(parent) if bundles[parent].bodies.len() == 1 => bundle.bodies.len(),
                _ => 1,
            },
            is_definite: (0..ABREAST).all(|lane| of_lane(lane).is_definite),
            // In a lane without such a body too.
            hangs_on_definite: bundle
                .parent
                .is_some_and(|parent| (0..ABREAST).all(|lane| whole.bodies[bundles[parent].body(lane)].is_definite)),
            is_leaf: last_child[k].is_none(),
            is_on_all_limbs: bundle.bodies.iter().all(Option::is_some),
            ..whole.bodies[bundle.first()].clone()
        };
        for lane in 0..ABREAST {
            let mut own = of_lane(lane).clone();
            take_lane(lane, body.numbers_mut(), own.numbers_mut());
            body.lever.take_limb(lane, &own.lever);
            let is_there = bundle.bodies.get(lane).is_some_and(Option::is_some);
            body.stands_for_itself.lanes_mut()[lane] = f64::from(u8::from(is_there));
        }
        if let Carrier::Turn(Axle::Tilted(at)) = &mut body.carrier {
            let own = tilt_of(&whole, &places_of(bundle), *at);
            *at = tilts.len();
            tilts.push(own);
        }
        if let Some(at) = &mut body.slide {
            let own = slide_of(&whole, &places_of(bundle), *at);
            *at = slides.len();
            slides.push(own);
        }
        let root_of_lane = |lane: usize| whole.roots[whole.at[bundle.body(lane)]];
        let mut root = root_of_lane(0);
        for lane in 1..ABREAST {
            take_lane(lane, root.numbers_mut(), root_of_lane(lane).numbers_mut());
        }
        roots.push(root);
        if let Carrier::Shift(at) = &mut body.carrier {
            let own = shift_of(&whole, &places_of(bundle), (*at, first.bodies[k].q));
            *at = shifting.len();
            shifting.push(own);
        } else {
            turning.push(turning_of(&whole, &places_of(bundle), (first.bodies[k].q, swept.at[k])));
        }
        bodies.push(body);
    }
    turning.sort_by_key(|turning| turning.place);
    let bodies: Vec<_> = order.iter().map(|&k| bodies[k].clone()).collect();
    let in_lanes = |whole_segments: &[Segment<Limbs>]| {
        let of_lane = |k: usize, lane: usize| &whole_segments[whole.at[bundles[k].body(lane)]];
        let own = |k: usize| {
            let first = of_lane(k, 0);
            OfSegment {
                arm: first.arm,
                load: first.load.clone(),
                needs_no_force: first.needs_no_force,
                waits_for_parent: first.waits_for_parent,
            }
        };
        let mut segments = segments(&bodies, own);
        for segment in &mut segments {
            for lane in 1..ABREAST {
                let mut own = of_lane(segment.index, lane).clone();
                take_lane(lane, segment.numbers_mut(), own.numbers_mut());
                segment.arm.take_limb(lane, &own.arm);
            }
        }
        segments
    };
    let (segments, whole_segments) = (in_lanes(&whole.segments), in_lanes(whole.whole_segments()));
    let roots = order.iter().map(|&k| roots[k]).collect();
    LeanModel {
        bodies,
        tilts,
        slides,
        reordered: Vec::new(),
        segments,
        whole_segments,
        at: swept.at,
        roots,
        composites: Vec::new(),
        shifting,
        turning,
        swept_slots: swept.slots,
        ..whole
    }
}
