//! Starts: the states from which motions begin, of a file or from code, and its keyframes.

use super::{Joint, Scene};
use crate::error::{Error, known_names};
use crate::setters::setters;
use std::collections::BTreeMap;
use std::ops::Range;

/// A state from which motions begin, by joint name: the start of a scene, or a keyframe.
///
/// ```
/// use phipsi::scene::Start;
/// # fn main() -> Result<(), phipsi::Error> {
/// let bent = Start::new(Some("bent")).with_q([("j1".to_owned(), vec![0.5])]);
/// let scene = phipsi::scenes::chain(3)?.source().clone().start(bent).build()?;
/// assert_eq!(scene.initial(None)?, scene.neutral());
/// assert_eq!(scene.initial(Some("bent"))?, [0.0, 0.5, 0.0]);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Start {
    /// Name of the keyframe; `None` for the start of the scene.
    pub keyframe: Option<String>,
    /// Coordinates of joints, rad or m. Other joints have those of the start, which are neutral by default.
    pub q: BTreeMap<String, Vec<f64>>,
    /// Velocities of joints, rad/s or m/s. Other joints have those of the start, which are zero by default.
    pub qd: BTreeMap<String, Vec<f64>>,
}

setters!(Start {
    with_q: q => BTreeMap<String, Vec<f64>>,
    with_qd: qd => BTreeMap<String, Vec<f64>>,
});

impl Start {
    /// A start, or a keyframe with a name, in which no joint has values of its own.
    #[must_use]
    pub fn new(keyframe: Option<&str>) -> Self {
        Self { keyframe: keyframe.map(str::to_owned), q: BTreeMap::new(), qd: BTreeMap::new() }
    }

    /// Removes joints, which [`Scene::lock`] fixes.
    pub(super) fn forget(&mut self, joints: &[&str]) {
        for of in [&mut self.q, &mut self.qd] {
            of.retain(|name, _| !joints.contains(&name.as_str()));
        }
    }

    /// The start in messages.
    fn subject(&self) -> String {
        self.keyframe.as_ref().map_or_else(|| "start".to_owned(), |name| format!("keyframe {name:?}"))
    }
}

/// Values of a start by joint.
type Values = fn(&Start) -> &BTreeMap<String, Vec<f64>>;
/// Indices of a joint in an array.
type Indices = fn(&Joint) -> &Range<usize>;

/// The coordinates and the velocities of a start, with their names.
const PARTS: [(&str, Values, Indices); 2] =
    [("q", |start| &start.q, |joint| &joint.q), ("qd", |start| &start.qd, |joint| &joint.v)];

impl Scene {
    /// Names of the keyframes, in the order of the file.
    pub fn keyframes(&self) -> impl Iterator<Item = &str> {
        self.source().starts.iter().filter_map(|start| start.keyframe.as_deref())
    }

    /// The configuration (nq) from which motions begin: that of the file, or of a keyframe. Neutral, unless the file or
    /// [`SceneBuilder::start`](super::SceneBuilder::start) defines another one.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown keyframe, which lists the existing names.
    pub fn initial(&self, keyframe: Option<&str>) -> Result<Vec<f64>, Error> {
        let mut q = self.neutral();
        self.put_start(keyframe, &mut q, PARTS[0])?;
        Ok(q)
    }

    /// The joint velocities (nv) of the start, or of a keyframe. Zero, unless the keyframe or
    /// [`SceneBuilder::start`](super::SceneBuilder::start) defines others.
    ///
    /// # Errors
    ///
    /// As [`Scene::initial`].
    pub fn initial_velocity(&self, keyframe: Option<&str>) -> Result<Vec<f64>, Error> {
        let mut qd = vec![0.0; self.nv()];
        self.put_start(keyframe, &mut qd, PARTS[1])?;
        Ok(qd)
    }

    /// Writes the values of the start, then those of a keyframe, to the entries of their joints. Joints that follow
    /// others (mimic) have no entries.
    fn put_start(
        &self,
        keyframe: Option<&str>,
        out: &mut [f64],
        (_, of, at): (&str, Values, Indices),
    ) -> Result<(), Error> {
        if let Some(name) = keyframe
            && !self.keyframes().any(|known| known == name)
        {
            return Err(self.unknown_keyframe(format!("{name:?}")));
        }
        let starts = &self.source().starts;
        let find = |name: Option<&str>| starts.iter().find(|start| start.keyframe.as_deref() == name);
        for start in [find(None), keyframe.and_then(|_| find(keyframe))].into_iter().flatten() {
            for joint in self.joints() {
                if let Some(values) = of(start).get(&joint.name) {
                    out[at(joint).clone()].copy_from_slice(values);
                }
            }
        }
        Ok(())
    }

    /// The error for a keyframe that the scene does not have.
    pub(crate) fn unknown_keyframe(&self, found: String) -> Error {
        let expected = match known_names(&found, self.keyframes(), 12) {
            names if names.is_empty() => "none, because the scene has no keyframes".to_owned(),
            names => format!("one of {names}"),
        };
        Error::argument("keyframe", found, expected)
    }

    /// Checks the starts of the scene of an assembled tree: the names of joints, and their values.
    pub(super) fn starting(self) -> Result<Self, Error> {
        for start in &self.source().starts {
            let subject = start.subject();
            for (what, of, at) in PARTS {
                for (name, values) in of(start) {
                    let joint = self.joint(name).map_err(|error| error.of_argument(&subject))?;
                    let count = at(joint).len();
                    if values.len() != count {
                        let found = format!("{} numbers for {what} of joint {name:?}", values.len());
                        return Err(Error::scene(subject, found, format!("{count}")));
                    }
                }
            }
            let keyframe = start.keyframe.as_deref();
            self.check_coordinates(&format!("q of {subject}"), &self.initial(keyframe)?)?;
            self.check_rates(&format!("qd of {subject}"), &self.initial_velocity(keyframe)?)?;
        }
        Ok(self)
    }

    /// Checks that the joints of the starts that follow others (mimic) are where these move them.
    pub(super) fn following(self) -> Result<Self, Error> {
        let Some(coupling) = self.coupling() else { return Ok(self) };
        for start in &self.source().starts {
            let keyframe = start.keyframe.as_deref();
            let mut q = coupling.configuration(&self.initial(keyframe)?);
            let mut qd = coupling.rates(&self.initial_velocity(keyframe)?);
            coupling.tree().put_start(keyframe, &mut q, PARTS[0])?;
            coupling.tree().put_start(keyframe, &mut qd, PARTS[1])?;
            coupling.check_followed(&q, &qd).map_err(|error| error.of_argument(&start.subject()))?;
        }
        Ok(self)
    }
}
