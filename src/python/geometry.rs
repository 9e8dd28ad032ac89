//! Methods of `Scene`: forward kinematics of all links, energy and momentum.

use super::errors::asked_by;
use super::keywords::Keywords;
use super::object::{Object, imported};
use super::output::Output;
use super::scene::PyScene;
use crate::algorithm::{KinematicQuantity, PLACEMENTS};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

methods! {
    /// Poses of all links by name (forward kinematics): homogeneous matrices from link to base frame.
    #[doc = parameters!(q errors)]
    #[doc = section!(Returns)]
    /// poses : dict of str to (..., 4, 4) ndarray
    ///     [[R, p], [0, 1]] with p in m, in the order of link_names; each value is an array of its own.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(N). placement computes the poses of some links only.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> scene.placements(scene.neutral())["flange"][:3, 3].round(3)
    /// array([0.412, 0.15 , 0.488])
    fn placements(q; errors) |scene, py| {
        let links = scene.scene.links();
        let cost = PLACEMENTS.cost[0] * (scene.size() + links.len());
        let call = scene.call([scene.configuration("q", q)?], cost, errors)?;
        let mut all = call.scratch_results(py, 16 * links.len())?;
        call.quantity_in_chunks(py, &KinematicQuantity::Poses(links), all.numbers()?)?;
        let shape = [&call.batch[..], &[4, 4]].concat();
        let placements = PyDict::new(py);
        for (at, link) in links.iter().enumerate() {
            let mut output = asked_by(py, &call.asking(), Output::new(py, &shape))?;
            output.gather(py, 16, all.numbers()?.chunks_exact(16).skip(at).step_by(links.len()))?;
            placements.set_item(&link.name, output.finish())?;
        }
        Ok(placements.into_any())
    }

    /// Poses of all links in one array (forward kinematics): homogeneous matrices from link to base frame.
    #[doc = parameters!(q errors)]
    #[doc = section!(Returns)]
    /// poses : (..., links, 4, 4) ndarray
    ///     [[R, p], [0, 1]] with p in m, in the order of link_names.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(N). Faster than placements, which makes an array for each link.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> poses = scene.poses(scene.neutral())
    /// >>> poses[scene.link_names.index("flange"), :3, 3].round(3)
    /// array([0.412, 0.15 , 0.488])
    fn poses(q; errors) |scene, py, keywords| {
        scene.kinematic_quantity(py, &KinematicQuantity::Poses(scene.scene.links()), [q], keywords)
    }

    /// Kinetic energy qd^T M qd / 2, including armature, and potential energy.
    #[doc = parameters!(q qd models errors)]
    #[doc = section!(Returns)]
    /// energy : Energy
    ///     Named tuple (kinetic, potential), each (...), J. The potential energy is zero with the center of mass at the
    ///     origin of the base frame.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(N). Springs are not included.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> energy = scene.energy([0.3, 0.2, 0.1], [1.0, 0.0, 0.0])
    /// >>> round(float(energy.kinetic), 3), round(float(energy.potential), 3)
    /// (0.123, 7.357)
    fn energy(q, qd; inertias, armature, errors) |scene, py, keywords| {
        let call = scene.call_of_quantity(&KinematicQuantity::Energy, [q, qd], keywords)?;
        let mut both = call.scratch_results(py, 2)?;
        call.quantity_in_chunks(py, &KinematicQuantity::Energy, both.numbers()?)?;
        let parts = call.pieces(py, both.numbers()?, &[[0; 0]; 2])?;
        imported!(py, "phipsi._results", "Energy")?.call1(PyTuple::new(py, parts)?)
    }

    /// Kinetic energy qd^T M qd / 2, including armature, in O(N).
    #[doc = parameters!(q qd models errors)]
    #[doc = section!(Returns)]
    /// kinetic : (...) ndarray
    ///     Kinetic energy, J.
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
    /// >>> np.allclose(scene.kinetic_energy(q, qd), qd @ scene.mass_matrix(q) @ qd / 2)
    /// True
    fn kinetic_energy(q, qd; inertias, armature, errors) => kinematic_quantity(&KinematicQuantity::KineticEnergy);

    /// Potential energy of gravity of all moving links, in O(N): minus gravity times the first moment of mass.
    #[doc = parameters!(q inertias errors)]
    #[doc = section!(Returns)]
    /// potential : (...) ndarray
    ///     Potential energy, J; zero with the center of mass at the origin of the base frame.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// Its derivative along the tangent space of q is gravity_torque(q). Springs do not contribute.
    #[doc = section!(Examples)]
    /// >>> scene, q = phipsi.scenes.chain(3), [0.3, 0.2, 0.1]
    /// >>> weight = scene.total_mass * np.array(scene.gravity)
    /// >>> np.allclose(scene.potential_energy(q), -weight @ scene.center_of_mass(q))
    /// True
    fn potential_energy(q; inertias, errors) => kinematic_quantity(&KinematicQuantity::PotentialEnergy);

    /// Spatial momentum of all moving links in the base frame: (angular about its origin, linear).
    #[doc = parameters!(q qd inertias errors)]
    #[doc = section!(Returns)]
    /// h : (..., 6) ndarray
    ///     Momentum, N m s and N s; armature does not contribute.
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
    /// >>> np.allclose(scene.momentum(q, qd)[3:], scene.total_mass * scene.center_of_mass_velocity(q, qd))
    /// True
    fn momentum(q, qd; inertias, errors) => kinematic_quantity(&KinematicQuantity::Momentum);
}
