//! Ignored parts of a URDF, and invalid limits: warnings of the scene, errors of a strict one.

use phipsi::Error;
use phipsi::scene::{Limits, SceneBuilder, SceneWarning};

const ARM: &str = r#"<robot name="arm">
<link name="base"/>
<link name="rod"><inertial><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="2" velocity="3"/><dynamics damping="0.1"/></joint>
</robot>"#;

#[track_caller]
fn arm_with(from: &str, to: &str) -> SceneBuilder {
    assert!(ARM.contains(from), "{from:?} is not in the arm");
    SceneBuilder::from_urdf(&ARM.replacen(from, to, 1)).unwrap()
}

/// Message of the error with strict.
#[track_caller]
fn strictly(builder: SceneBuilder) -> String {
    let error = builder.strict(true).build().unwrap_err();
    assert!(matches!(error, Error::Scene { .. }));
    error.to_string()
}

#[test]
fn what_is_not_understood_is_one_warning_and_an_error_if_strict() {
    let builder = arm_with("damping", "dampng").clone();
    let scene = builder.clone().build().unwrap();
    let [SceneWarning::NotUnderstood { source, found }] = scene.warnings() else { panic!("{:?}", scene.warnings()) };
    assert_eq!(source, "URDF");
    assert_eq!(found, r#"attribute dampng of <dynamics> of joint "hinge" (line 6; is it damping?)"#);
    let message = strictly(builder);
    assert!(message.contains("dampng") && message.contains("strict"), "{message}");
}

#[test]
#[allow(clippy::float_cmp)] // exactly the value in the file
fn limits_that_mean_nothing_are_none() {
    let builder = arm_with(
        r#"lower="-1" upper="1" effort="2" velocity="3""#,
        r#"lower="1" upper="-1" effort="-1" velocity="-2""#,
    );
    let scene = builder.clone().build().unwrap();
    assert_eq!(scene.joints()[0].limits, Limits::default());
    let [SceneWarning::Limits { found }] = scene.warnings() else { panic!("{:?}", scene.warnings()) };
    assert_eq!(found, r#"joint "hinge": lower 1 above upper -1, velocity -2 below zero, effort -1 below zero"#);
    assert!(strictly(builder).contains("lower 1 above upper -1"));
}

#[test]
fn moving_links_that_all_have_no_mass() {
    let builder = arm_with("value=\"1\"", "value=\"0\"");
    assert_eq!(builder.clone().build().unwrap().warnings(), [], "inertia is enough");
    let text = ARM.replace(&ARM[ARM.find("<inertial>").unwrap()..ARM.find("</link>").unwrap()], "");
    let builder = SceneBuilder::from_urdf(&text).unwrap();
    let scene = builder.clone().build().unwrap();
    assert_eq!(scene.warnings(), [SceneWarning::NoMass { links: vec!["rod".into()] }]);
    assert!(scene.warnings()[0].to_string().starts_with("1 of 1 moving link has no mass: \"rod\""));
    assert!(strictly(builder).contains("1 of 1 moving link has no mass"));
}

/// Names and broken documents of any size take linear time.
#[test]
fn many_findings_and_prefixes_are_quick() {
    let start = std::time::Instant::now();
    let many = 100_000;
    for odd in [
        "<odd/>",
        "<a:b c:d='e'/>",
        "text<!-- -- -->",
        "<transmission><actuator><gear_ratio/></actuator></transmission>",
    ] {
        let scene = arm_with("</robot>", &format!("{}</robot>", odd.repeat(many))).build().unwrap();
        assert!(scene.warnings().iter().all(|warning| warning.to_string().len() < 2000), "{odd}");
    }
    assert!(start.elapsed() < std::time::Duration::from_secs(60), "{:?}", start.elapsed());
}
