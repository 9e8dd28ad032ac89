//! Parts that many docstrings share, in numpydoc form. `section!(Notes)` begins a section with a blank line;
//! `parameters!(q qd errors)`, `returns!(..)` and `raises!(..)` begin one with these entries; `entries!(..)` adds
//! entries. `test_docstrings.py` checks the sections of all methods and runs their examples.

/// A macro that returns the text of a name.
macro_rules! texts {
    ($macro:ident, $($name:ident: $text:expr;)*) => {
        macro_rules! $macro {
            $(($name) => { $text };)*
        }
    };
}

texts! {
    entry,
    q: "q : (..., nq) array_like
    Joint positions, rad or m.";
    qd: "qd : (..., nv) array_like
    Joint velocities, rad/s or m/s.";
    qdd: "qdd : (..., nv) array_like
    Joint accelerations, rad/s^2 or m/s^2.";
    tau: "tau : (..., nv) array_like
    Joint torques, N m or N; those of a free joint are (force, moment).";
    dq: "dq : (..., nv) array_like
    Change of q in its tangent space: the displacement that integrate(q, dq) applies.";
    dqd: "dqd : (..., nv) array_like
    Change of qd.";
    dqdd: "dqdd : (..., nv) array_like
    Change of qdd.";
    dtau: "dtau : (..., nv) array_like
    Change of tau.";
    constants: "dwrenches : dict of str to (..., 6) array_like, optional
    Changes of the wrenches, by link name.
dparameters : (..., bodies, 10) array_like, optional
    Changes of the inertial parameters of the links of body_names, as InverseDynamicsGradients orders them.
darmature : (..., nv) array_like, optional
    Changes of the armature.
dgravity : (..., 3) array_like, optional
    Change of gravity in the base frame.";
    parameters: "parameters : bool, default False
    If true, compute the gradients with respect to inertial parameters, armature and gravity too.";
    wrenches: "wrenches : dict of str to (..., 6) array_like, optional
    External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
    the link, N m and N.";
    inertias: "inertias : (..., bodies, 10) array_like, optional
    Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
    model per state.";
    models: concat!(entry!(inertias), "\n", entry!(armature));
    armature: "armature : (..., nv) array_like or float, optional
    Armature of each state instead of that of the scene, kg m^2 or kg.";
    form: r#"form : {"auto", "covariance", "square-root"}, default "auto"
    Form of the covariance P; see forward_dynamics."#;
    tolerance: r#"tolerance : float, optional
    Largest accepted relative error in the forms "auto" and "square-root"; see forward_dynamics."#;
    out: "out : ndarray, optional
    C-contiguous array of the shape and dtype of the result, without overlap with the arguments. It is returned.";
    dtype: r#"dtype : {"float64", "float32"} or numpy dtype, optional
    Type of the result, float64 by default; float32 results are the float64 results rounded."#;
    errors: r#"errors : {"raise", "nan"}, default "raise"
    "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics."#;
    link: "link : str
    Name of the link.";
    frame: r#"frame : {"local", "world", "local-world-aligned"}, default "local"
    Frame of the result; see velocity."#;
    at: "at : (3,) array_like, optional
    Point fixed to the link, in the link frame, m; its origin by default.";
    compliance: "compliance : float or (..., m) array_like, optional
    Compliance of each row of the connections in the order of loops.rows, (m/s^2)/N or (rad/s^2)/(N m), not
    negative. None: the connections are rigid.";
    leave_out: r#"leave_out : collection of str, optional
    Names of the simplifications to allow: "fixed_joints", "base_links", "permuted_axes", "oblique_axes",
    "zero_velocity" and "zero_gravity". None: all. They change results by rounding only; see Scene.plan."#;
    losses: "damping : float or (nv,) array_like, optional
    Viscous damping instead of that of the scene, N m s/rad or N s/m.
stiffness : float or (nv,) array_like, optional
    Stiffness of the springs instead of that of the scene, N m/rad or N/m.
rest : (nq,) array_like, optional
    Configuration in which the springs are at rest, instead of that of the scene.
friction : float or (nv,) array_like, optional
    Coulomb friction instead of that of the scene, N m or N.";
    tolerance_of_derivatives: "tolerance : float, optional
    As in forward_dynamics_derivatives.";
    out_of_derivatives: "out : (..., 3, nv, nv) ndarray, optional
    C-contiguous float64 array; the results are views of it. Large batches take half the time into a reused one.";
    task_frames: "at : (3,) or (m, 3) array_like, optional
    Origins of the task frames in the link frames, m; zero by default. The same for the whole batch.
rotation : (3, 3) or (m, 3, 3) array_like, optional
    Axes of the task frames in the link frames; the identity by default. The same for the whole batch.";
    directory: "directory : str or os.PathLike, optional
    Directory to write the files to; it is created if necessary. None: no files.";
    functions: "functions : iterable of str or tuple, optional
    As in to_c.";
    samples: "samples : int
    Number of samples.
seed : int
    Seed, from 0 to 2^64 - 1.";
    builder: "builder : SceneBuilder
    The same builder.";
    scene: "scene : Scene
    The new scene.";
    arguments: "ShapeError, NotFiniteError, ArgumentError
    An invalid argument or an unknown name. The message names the argument and the state.";
    singular: "SingularJointError
    A joint without inertia along its axis: its pivot D(k) is lost in rounding.";
    dense: "ArgumentError
    A scene of more than 4000 degrees of freedom, too many for dense matrices.";
    unknown: "ArgumentError
    An unknown name. The message lists the names that exist.";
    as_to_c: "ArgumentError
    An invalid name, and as to_c.
OSError
    Files that cannot be written.";
    memory: "OutOfMemoryError
    A result that does not fit in memory. The message names the argument that determines its size.";
}

macro_rules! entries {
    ($first:ident $($other:ident)*) => {
        concat!(entry!($first), $("\n", entry!($other)),*)
    };
}

texts! {
    section,
    Parameters: "\nParameters\n----------";
    Returns: "\nReturns\n-------";
    Raises: "\nRaises\n------";
    Warns: "\nWarns\n-----";
    Notes: "\nNotes\n-----";
    Examples: "\nExamples\n--------";
}

macro_rules! parameters {
    ($($name:ident)+) => {
        concat!(section!(Parameters), "\n", entries!($($name)+))
    };
}

macro_rules! returns {
    ($($name:ident)+) => {
        concat!(section!(Returns), "\n", entries!($($name)+))
    };
}

macro_rules! raises {
    ($($name:ident)+) => {
        concat!(section!(Raises), "\n", entries!($($name)+))
    };
}
