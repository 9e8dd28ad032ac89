//! Contact kinematics of a scene at one state.

use crate::dynamics::contact_kernel::ContactKernel;
use crate::dynamics::forward::factorise;
use crate::error::{Error, check_length};
use crate::scene::Scene;
use crate::workspace::Workspace;
use nalgebra::DMatrix;

/// A scene with at most this many contacts counts as coupled.
const FEW_CONTACTS: usize = 8;

/// Largest number of entries of G, relative to those that are not zero, of coupled contacts.
const MOSTLY_ZERO: usize = 4;

impl Scene {
    /// Signed distance of each contact from its surface at `q`, written to `out` (contacts), m; negative for
    /// penetration. O(depth) per contact.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`] (also for two spheres whose centers coincide), and [`Error::Argument`]
    /// for a quaternion that is not of unit norm.
    pub fn contact_gaps(&self, q: &[f64], out: &mut [f64]) -> Result<(), Error> {
        let (tree, q) = (self.tree(), self.tree_configuration("q", q)?);
        check_length("out", out.len(), tree.contact_points().len())?;
        for (point, out) in tree.contact_points().iter().zip(out.iter_mut()) {
            *out = point.touch_at(tree.model(), &q).gap;
        }
        self.check_result("contact gaps", out)
    }

    /// Velocity of each contact point (the point of the link nearest to the surface) relative to the link of the
    /// surface, in the base frame, m/s, written to `out` (contacts x 3). O(depth) per contact.
    ///
    /// # Errors
    ///
    /// As [`Scene::contact_gaps`].
    pub fn contact_velocities(&self, q: &[f64], qd: &[f64], out: &mut [f64]) -> Result<(), Error> {
        let (tree, q) = (self.tree(), self.tree_configuration("q", q)?);
        let qd = self.tree_rates("qd", qd)?;
        check_length("out", out.len(), 3 * tree.contact_points().len())?;
        for (point, out) in tree.contact_points().iter().zip(out.chunks_exact_mut(3)) {
            out.copy_from_slice(point.velocity(tree.model(), &q, &qd).0.as_slice());
        }
        self.check_result("contact velocities", out)
    }

    /// The point of each contact at which its force acts, in the base frame, m, (contacts x 3).
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn contact_positions(&self, q: &[f64], out: &mut [f64]) -> Result<(), Error> {
        let (tree, q) = (self.tree(), self.tree_configuration("q", q)?);
        for (point, out) in tree.contact_points().iter().zip(out.chunks_exact_mut(3)) {
            out.copy_from_slice(point.touch_at(tree.model(), &q).at.as_slice());
        }
        self.check_result("contact positions", out)
    }

    /// J M^-1 J^T of the points of all contacts at `q`, (contacts x 3 x contacts x 3) row by row, written to `out`: the
    /// velocities ([`Scene::contact_velocities`]) of all points, in the base frame, due to unit impulses along the axes
    /// of the base frame. Symmetric and positive semidefinite, 1/kg. The factor of M has the form of the workspace.
    /// With connections M^-1 is that of [`Scene::constrained_mass_matrix_inverse`], and with mimic joints J and M^-1
    /// are those of the independent joints.
    ///
    /// # Errors
    ///
    /// As [`Scene::contact_gaps`], and [`Error::SingularJoint`].
    pub fn contact_gram(&self, workspace: &mut Workspace<f64>, q: &[f64], out: &mut [f64]) -> Result<(), Error> {
        let rows = 3 * self.tree().contact_points().len();
        check_length("out", out.len(), rows * rows)?;
        self.check_workspace(workspace)?;
        self.check_form(workspace)?;
        if self.coupling().is_some() || !self.constraints().is_empty() || !self.contacts_have_planes() {
            let (mut transpose, mut unit) = (DMatrix::from_element(self.nv(), rows, f64::NAN), vec![0.0; self.nv()]);
            let mut moved = vec![f64::NAN; rows];
            for (row, mut of_row) in transpose.row_iter_mut().enumerate() {
                unit[row] = 1.0;
                self.contact_velocities(q, &unit, &mut moved)?;
                of_row.copy_from_slice(&moved);
                unit[row] = 0.0;
            }
            self.gram_through_rows(workspace, q, &transpose, out)?;
            return self.check_result("contact gram", out);
        }
        self.check_configuration("q", q)?;
        let pivots = factorise(self.model(), workspace, q);
        self.check_pivots(workspace, pivots)?;
        let (scene, store) = workspace.passes(self.model());
        ContactKernel::new(scene, self.contact_points()).along_base_axes().gram_at(scene, store, out);
        self.check_result("contact gram", out)
    }

    /// True if every contact has a plane of the base.
    pub(crate) fn contacts_have_planes(&self) -> bool {
        self.tree().contact_points().iter().all(|point| point.other.is_none())
    }

    /// True unless contacts are on many trees, such that most blocks of G are zero.
    pub(crate) fn contacts_are_coupled(&self) -> bool {
        let points = self.tree().contact_points();
        if points.len() <= FEW_CONTACTS {
            return true;
        }
        let mut on_tree = vec![0_usize; self.tree().model().bodies.len()];
        for point in points {
            point.path.last().into_iter().for_each(|&root| on_tree[root] += 1);
        }
        points.len().pow(2) <= MOSTLY_ZERO * on_tree.iter().map(|n| n * n).sum::<usize>()
    }

    /// Returns an error if the scene has contacts, for functions that do not support them.
    #[cfg(feature = "python")]
    pub(crate) fn check_no_contacts(&self, what: &str) -> Result<(), Error> {
        if !self.touches() {
            return Ok(());
        }
        let names = self.contacts().iter().map(|of| &of.name).chain(self.colliders().iter().map(|of| &of.name));
        let names: Vec<String> = names.take(8).map(|name| format!("{name:?}")).collect();
        Err(Error::argument(
            what,
            format!("a scene with contacts or colliders ({})", names.join(", ")),
            "a scene without contacts: scene.without_contacts() returns one",
        ))
    }
}
