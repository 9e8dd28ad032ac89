//! The URDF reader: supported input, errors and their messages, and linear time without panics for any input.

use crate::common::Random;
use crate::common::tolerance::{assert_near, product};
use nalgebra::Vector3;
use phipsi::scene::{JointDescription, JointKind, Limits, Mimic, SceneBuilder, SceneWarning};
use phipsi::{Error, Scene};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn mixed() -> SceneBuilder {
    SceneBuilder::from_urdf_file(data("mixed.urdf")).expect("mixed.urdf is valid")
}

fn joint<'a>(builder: &'a SceneBuilder, name: &str) -> &'a JointDescription {
    builder.joints().iter().find(|joint| joint.name == name).expect("the joint is in the file")
}

/// Reads and builds.
fn scene(xml: &str) -> Result<Scene, Error> {
    SceneBuilder::from_urdf(xml)?.build()
}

/// Message of the scene error for a text.
#[track_caller]
fn refusal(xml: &str) -> String {
    match scene(xml) {
        Err(error @ Error::Scene { .. }) => error.to_string(),
        Err(error) => panic!("not a scene error: {error}"),
        Ok(_) => panic!("accepted"),
    }
}

/// Asserts that a message has all the parts.
#[track_caller]
fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{message:?} does not say {part:?}");
    }
}

/// Two links and a joint; `edit` replaces the first text by the second and must find it.
#[track_caller]
fn arm_with(from: &str, to: &str) -> String {
    let arm = r#"<robot name="arm">
<link name="base"/>
<link name="rod"><inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="hinge" type="revolute"><origin xyz="0 0 1"/><parent link="base"/><child link="rod"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="2" velocity="3"/><dynamics damping="0.1"/></joint>
</robot>"#;
    assert!(arm.contains(from), "{from:?} is not in the arm");
    arm.replacen(from, to, 1)
}

#[test]
fn every_joint_type_and_attribute_is_read() {
    let builder = mixed();
    let kinds: Vec<_> = builder.joints().iter().map(|joint| (joint.name.as_str(), joint.kind)).collect();
    assert_eq!(
        kinds,
        [
            ("shoulder", JointKind::Revolute),
            ("spin", JointKind::Continuous),
            ("slide", JointKind::Prismatic),
            ("weld", JointKind::Fixed),
            ("table", JointKind::Planar),
            ("air", JointKind::Floating),
            ("neck", JointKind::Spherical),
        ]
    );
    let shoulder = joint(&builder, "shoulder");
    assert_eq!((shoulder.parent.as_str(), shoulder.child.as_str()), ("base", "upper"));
    assert_eq!(shoulder.axis, Vector3::new(0.0, -2.0, 0.0));
    assert_eq!(shoulder.origin.lever, Vector3::new(1.0, 2.0, 3.0));
    assert_eq!(
        shoulder.limits,
        Limits::default().with_lower(-1.5).with_upper(2.5).with_velocity(3.0).with_effort(40.0)
    );
    assert_eq!((shoulder.damping, shoulder.friction, shoulder.armature), (0.6, 0.7, 0.8));
    assert_eq!(shoulder.mimic, None);

    let spin = joint(&builder, "spin");
    assert_eq!(spin.axis, Vector3::new(1.0, 0.0, 0.0), "the axis defaults to x");
    assert_eq!(spin.limits, Limits::default().with_velocity(9.0).with_effort(8.0), "continuous: no lower, upper");
    assert_eq!(spin.mimic, Some(Mimic::of("shoulder").with_multiplier(2.0)));

    let slide = joint(&builder, "slide");
    assert_eq!(slide.limits, Limits::default().with_lower(0.0).with_upper(0.4).with_velocity(1.0));
    assert_eq!(joint(&builder, "weld").origin.lever, Vector3::new(0.0, 0.0, 0.1));
    assert_eq!(joint(&builder, "table").limits, Limits::default());

    let names: Vec<_> = builder.links().iter().map(|link| link.name.as_str()).collect();
    assert_eq!(names, ["base", "upper", "wheel", "slider", "flange", "puck", "drone", "head"]);
    assert_eq!(builder.links()[0].inertial, None);
}

#[test]
#[allow(clippy::float_cmp)] // exactly the value in the file
fn rotations_and_turned_inertias_agree_with_mpmath() {
    let builder = mixed();
    // Rz Ry Rx of the decimals in the file, and R I R^T: mpmath 1.4, 40 digits.
    let rotation = [
        [-0.443_044_137_835_118, -0.504_294_993_445_900_8, -0.741_214_173_849_458_9],
        [0.757_537_487_431_484_7, -0.652_733_619_979_183_6, -0.008_704_968_975_475_487],
        [-0.479_425_538_604_203, -0.565_354_208_381_143_8, 0.671_212_166_158_957_6],
    ];
    let read = joint(&builder, "shoulder").origin.rotation;
    assert_near("rotation", read.transpose().as_slice(), rotation.as_flattened(), product(1, 1.0));

    let inertial = builder.links()[1].inertial.expect("upper has one");
    assert_eq!(inertial.mass, 2.5);
    assert_eq!(inertial.center, Vector3::new(0.1, -0.2, 0.3));
    let central = [
        0.027_487_422_050_898_987,
        -0.002_792_494_047_308_832,
        -0.003_377_004_660_797_754_5,
        0.026_007_987_109_741_86,
        -0.007_906_855_132_719_303,
        0.036_504_590_839_359_15,
    ];
    assert_near("inertia", &inertial.central.entries, &central, product(1, 0.04));
}

#[test]
fn a_mixed_scene_builds_with_fixed_and_floating_base() {
    let fixed = mixed().build().unwrap();
    assert_eq!((fixed.nq(), fixed.nv()), (1 + 1 + 1 + 3 + 7 + 4, 1 + 1 + 1 + 3 + 6 + 3));
    let order: Vec<_> = fixed.joints().iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(order, ["shoulder", "spin", "slide", "neck", "table", "air"], "depth first, siblings in file order");
    assert_eq!(fixed.merged_joints(), ["weld"]);
    let mimic = SceneWarning::Mimic { joint: "spin".into(), source: "shoulder".into() };
    assert_eq!(fixed.warnings(), [mimic]);
    let floating = mixed().floating_base(true).build().unwrap();
    assert_eq!((floating.nq(), floating.nv()), (fixed.nq() + 7, fixed.nv() + 6));
}

#[test]
#[allow(clippy::float_cmp)] // exactly the value in the file
fn limits_left_out() {
    let limits = |xml: &str| scene(xml).unwrap().joint("hinge").unwrap().limits;
    let element = r#"<limit lower="-1" upper="1" effort="2" velocity="3"/>"#;
    assert_eq!(limits(&arm_with(element, "")), Limits::default());
    assert_eq!(limits(&arm_with(element, r#"<limit effort="2"/>"#)), Limits::default().with_effort(2.0));
    assert_eq!(limits(&arm_with(element, r#"<limit lower="-1"/>"#)).upper, 0.0);
}

#[test]
fn bytes_before_the_xml_are_passed_over_and_still_counted() {
    let xml = format!("<?xml version='1.0'?>\n{}", arm_with("arm", "arm"));
    for before in ["\u{feff}", "\n \n", "\u{feff}\r\n", " \u{feff}"] {
        assert_eq!(scene(&format!("{before}{xml}")).unwrap().nv(), 1, "{before:?}");
    }
    assert_says(&refusal("\n\n  <robot><link></robot>"), &["URDF, line 3, column 16:", "malformed XML"]);
    assert_says(&refusal("\u{feff}<robot><link></robot>"), &["URDF, line 1, column 14:"]);
    assert_says(&refusal("\n<robot>\n <joint/>\n</robot>"), &["URDF, line 3, column 2:", "<joint> without name"]);
}

#[test]
fn namespaces() {
    let whole = arm_with("<robot ", r#"<robot xmlns="http://example.org/urdf" "#);
    assert_eq!(scene(&whole).unwrap().nv(), 1, "a default namespace for the whole document");
    let xacro = "<robot xmlns:xacro='http://www.ros.org/wiki/xacro'>\n<xacro:property name='a' value='1'/></robot>";
    assert_says(&refusal(xacro), &["line 2, column 1", "<xacro:property>", "run xacro"]);
}

#[test]
fn malformed_documents() {
    for (xml, parts) in [
        ("", &["URDF: found nothing; expected XML"][..]),
        (" \n\t", &["found nothing"]),
        ("arm.urdf", &["found text that starts with \"arm.urdf\"", "from_urdf_file"]),
        ("<robot>\n<link name='a'>\n</robot>", &["URDF, line 3, column 1: found malformed XML", "'link'"]),
        ("<robot>\n<link name='a'/>\n", &["URDF, line 3, column 1: found malformed XML", "never closed"]),
        ("<robot><link name='a' name='b'/></robot>", &["line 1, column 23", "'name'"]),
        ("<robot><a:link/></robot>", &["line 1, column 9", "'a'"]),
        ("<sdf version='1.6'/>", &["found root element <sdf>; expected <robot>", "SDF"]),
        ("<robot name='stub'/>", &["found a <robot> without links; expected at least one <link>"]),
        ("<robot><link/></robot>", &["line 1, column 8: found a <link> without name"]),
        ("<!DOCTYPE robot [<!ENTITY a 'aa'>]><robot/>", &["declares entities"]),
        ("<robot><link name='&lol;'/></robot>", &["line 1, column 20", "lol"]),
    ] {
        assert_says(&refusal(xml), parts);
    }
}

#[test]
fn each_broken_link_or_joint_is_named_with_what_was_found_and_expected() {
    let types = "one of the types revolute, continuous, prismatic, fixed, floating, planar, spherical";
    for (from, to, parts) in [
        (r#" type="revolute""#, "", &["joint \"hinge\": found no type", types][..]),
        ("revolute", "hinge2", &["joint \"hinge\": found type \"hinge2\"", types]),
        (r#"<parent link="base"/>"#, "", &["joint \"hinge\": found no <parent>"]),
        (r#"<parent link="base"/>"#, "<parent/>", &["joint \"hinge\": found no link in <parent>"]),
        (r#"<child link="rod"/>"#, "", &["joint \"hinge\": found no <child>"]),
        (r#"<parent link="base"/>"#, r#"<parent link="bas"/>"#, &["joint \"hinge\"", "\"bas\"", "\"base\", \"rod\""]),
        (r#"joint name="hinge""#, "joint", &["URDF, line 5, column 1: found a <joint> without name"]),
        (r#"joint name="hinge""#, r#"joint name="""#, &["line 5, column 1", "without name"]),
        ("0 0 0.1", "0 abc 0", &["link \"rod\": found \"0 abc 0\" in xyz of <origin>; expected three numbers"]),
        ("0 0 0.1", "0 0.1", &["link \"rod\": found \"0 0.1\" in xyz of <origin>; expected three numbers"]),
        ("0 0 0.1", "0 0 0 1", &["link \"rod\": found \"0 0 0 1\" in xyz", "three numbers"]),
        ("0 0 0.1", "0, 0, 1", &["found \"0, 0, 1\" in xyz", "three numbers"]),
        ("0 0 0.1", "", &["link \"rod\": found \"\" in xyz", "three numbers"]),
        ("0 0 0.1", "0 nan 0", &["found \"0 nan 0\" in xyz of <origin>; expected three finite numbers"]),
        ("0 0 0.1", "0 1e999 0", &["found \"0 1e999 0\" in xyz", "three finite numbers"]),
        (r#"rpy="0 0 0""#, r#"rpy="0 0 -inf""#, &["in rpy of <origin>; expected three finite numbers"]),
        (r#"rpy="0 0 0""#, r#"quat_xyzw="0 0 0 1""#, &["link \"rod\": found quat_xyzw", "rpy"]),
        (r#"<mass value="1"/>"#, "", &["link \"rod\": found no <mass> in <inertial>"]),
        (r#"<mass value="1"/>"#, "<mass/>", &["link \"rod\": found no value in <mass>"]),
        (r#"value="1""#, r#"value="-1""#, &["link \"rod\": found mass -1"]),
        (
            r#"value="1""#,
            r#"value="NaN""#,
            &["link \"rod\": found \"NaN\" in value of <mass>; expected a finite number"],
        ),
        (r#"value="1""#, r#"value="1kg""#, &["found \"1kg\" in value of <mass>; expected a number"]),
        (r#"ixy="0" "#, "", &["link \"rod\": found no ixy in <inertia>"]),
        (r#"izz="0.1""#, r#"izz="inf""#, &["link \"rod\": found \"inf\" in izz"]),
        (r#"ixx="0.1""#, r#"ixx="0.1 0.1""#, &["found \"0.1 0.1\" in ixx of <inertia>; expected a number"]),
        ("0 1 0", "0 0 0", &["joint \"hinge\": found axis (0, 0, 0)"]),
        (r#"lower="-1""#, r#"lower="nan""#, &["joint \"hinge\": found \"nan\" in lower of <limit>; expected a number"]),
        (r#"damping="0.1""#, r#"damping="inf""#, &["found \"inf\" in damping of <dynamics>; expected a finite number"]),
        (r#"damping="0.1""#, r#"armature="-1""#, &["joint \"hinge\": found armature -1"]),
        ("</joint>", "<mimic/></joint>", &["joint \"hinge\": found no joint in <mimic>"]),
        (r#"link name="rod""#, r#"link name="base""#, &["link \"base\": found a duplicate name"]),
    ] {
        assert_says(&refusal(&arm_with(from, to)), parts);
    }
}

#[test]
fn long_values_are_cut_in_messages() {
    let message = refusal(&arm_with("0 0 0.1", &"1 ".repeat(100_000)));
    assert_says(&message, &["link \"rod\"", "\"1 1 1", "\"... in xyz"]);
    assert!(message.len() < 300, "{} bytes", message.len());
}

#[test]
fn a_mimic_of_an_unknown_joint_is_a_warning_and_an_error_if_strict() {
    let builder = SceneBuilder::from_urdf(&arm_with("</joint>", r#"<mimic joint="ghost"/></joint>"#)).unwrap();
    let warning = SceneWarning::Mimic { joint: "hinge".into(), source: "ghost".into() };
    assert_eq!(builder.clone().build().unwrap().warnings(), [warning]);
    let message = builder.strict(true).build().unwrap_err().to_string();
    assert_says(&message, &["joint \"hinge\"", "\"ghost\"", "strict"]);
}

#[test]
fn files_that_cannot_be_read() {
    let directory = std::env::temp_dir().join(format!("phipsi-urdf-{}", std::process::id()));
    std::fs::create_dir_all(&directory).unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = directory.join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let mut random = Random::new(1);
    let noise: Vec<u8> = std::iter::repeat_with(|| random.bits().to_le_bytes()).take(1_250_000).flatten().collect();
    for (path, part) in [
        (directory.join("none.urdf"), "no such file"),
        (directory.clone(), "a directory"),
        (write("empty.urdf", b""), "nothing"),
        (write("latin1.urdf", b"<robot name='\xe9'/>"), "not UTF-8 at offset 13"),
        (write("utf16.urdf", b"\xff\xfe<\0r\0"), "not UTF-8 at offset 0"),
        (write("noise.urdf", &noise), "not UTF-8"),
        (write("sdf.urdf", b"<sdf/>"), "root element <sdf>"),
    ] {
        let message = SceneBuilder::from_urdf_file(&path).unwrap_err().to_string();
        assert_says(&message, &[&format!("file {:?}", path.display().to_string()), part]);
    }
    std::fs::remove_dir_all(&directory).unwrap();
}

/// Random texts and broken files end in an error (or a scene), never in a panic.
#[test]
fn no_text_panics() {
    let mut random = Random::new(2);
    let whole = std::fs::read(data("mixed.urdf")).unwrap();
    for _ in 0..2000 {
        let mut bytes = whole.clone();
        for _ in 0..=random.below(4) {
            let at = random.below(bytes.len().max(1));
            match random.below(3) {
                0 if at < bytes.len() => bytes[at] = b"<>/\"'&= \n0-.e9\0\xff"[random.below(16)],
                1 => drop(bytes.drain(at..(at + random.below(40)).min(bytes.len()))),
                _ if random.below(8) == 0 => bytes.truncate(at + 1),
                _ => {}
            }
        }
        if let Err(error) = scene(&String::from_utf8_lossy(&bytes)) {
            assert!(matches!(error, Error::Scene { .. }), "{error}");
        }
    }
    for value in ["1e308", "-1e308", "5e-324", "1e-200", "-0", "1e155"] {
        for entry in ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"] {
            let zero = if entry.as_bytes()[1] == entry.as_bytes()[2] { "0.1" } else { "0" };
            drop(scene(&arm_with(&format!("{entry}=\"{zero}\""), &format!("{entry}=\"{value}\""))));
        }
    }
}

#[test]
fn deep_nesting_and_long_chains_are_quick() {
    let start = Instant::now();
    let depth = 1_000_000;
    assert_says(&refusal(&format!("<robot>{}", "<a>".repeat(depth))), &["malformed XML"]);
    assert_says(
        &refusal(&format!("<robot>{}{}</robot>", "<a>".repeat(depth), "</a>".repeat(depth))),
        &["without links"],
    );

    let n = if cfg!(debug_assertions) { 20_000 } else { 100_000 };
    let mut xml = String::from("<robot><link name='l0'/>");
    for i in 1..=n {
        write!(
            xml,
            "<link name='l{i}'><inertial><mass value='1'/>\
             <inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial></link>\
             <joint name='j{i}' type='continuous'><parent link='l{}'/><child link='l{i}'/></joint>",
            i - 1
        )
        .unwrap();
    }
    xml += "</robot>";
    assert_eq!(scene(&xml).unwrap().nv(), n);
    assert_eq!(scene(&xml.replace("continuous", "fixed")).unwrap().merged_joints().len(), n);
    // A few seconds; in release, anything quadratic in the links takes minutes.
    assert!(start.elapsed() < Duration::from_secs(90), "{:?}", start.elapsed());
}

#[test]
fn inertias_that_no_body_has_are_told_and_rounding_is_not() {
    let warnings = |ixx: &str, iyy: &str, izz: &str, ixy: &str| {
        let from = r#"ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1""#;
        let to = format!(r#"ixx="{ixx}" ixy="{ixy}" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}""#);
        scene(&arm_with(from, &to)).unwrap().warnings().to_vec()
    };
    // A thin plate: izz = ixx + iyy, exactly and rounded up to six digits.
    assert_eq!(warnings("0.1", "0.2", "0.3", "0"), []);
    assert_eq!(warnings("0.100000", "0.100000", "0.200001", "0"), []);
    // A rod, a point, a sphere.
    assert_eq!(warnings("0.1", "0.1", "0", "0"), []);
    assert_eq!(warnings("0", "0", "0", "0"), []);
    assert_eq!(warnings("1e-20", "1e-20", "1e-20", "0"), []);
    for (ixx, iyy, izz, ixy, part) in [
        ("0.1", "0.1", "0.201", "0", "triangle"),
        ("1e-20", "1e-20", "3e-20", "0", "triangle"),
        ("0.1", "0.1", "0.1", "0.11", "negative"),
        ("-0.1", "-0.1", "0", "0", "negative"),
    ] {
        let found = warnings(ixx, iyy, izz, ixy);
        let [SceneWarning::Inertia { link, found }] = &found[..] else { panic!("{found:?}") };
        assert_eq!(link, "rod");
        assert_says(found, &[part]);
    }
}

/// Runs if `PHIPSI_ROBOTS` is the folder share/example-robot-data/robots of the `PyPI` package.
#[test]
fn example_robot_data() {
    let Some(folder) = std::env::var_os("PHIPSI_ROBOTS") else {
        println!("skipped: PHIPSI_ROBOTS is not set");
        return;
    };
    let mut files = Vec::new();
    let mut folders = vec![PathBuf::from(folder)];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "urdf") {
                files.push(path);
            }
        }
    }
    assert_eq!(files.len(), 69);
    let (mut loaded, mut unphysical, mut links) = (0, 0, 0);
    for path in files {
        let builder = SceneBuilder::from_urdf_file(&path);
        if path.ends_with("ur3.urdf") {
            assert_says(&builder.unwrap_err().to_string(), &["ur3.urdf", "without links"]);
            continue;
        }
        let builder = builder.unwrap();
        let fixed = builder.clone().build().unwrap();
        let floating = builder.clone().floating_base(true).build().unwrap();
        assert_eq!(floating.nv(), fixed.nv() + 6, "{}", path.display());
        let told = fixed.warnings().iter().filter(|w| matches!(w, SceneWarning::Inertia { .. })).count();
        assert!(told == 0 || builder.strict(true).build().is_err(), "{}", path.display());
        loaded += 1;
        unphysical += usize::from(told > 0);
        links += told;
    }
    // The two files called anymal.urdf are different robots; counted by name there are 17.
    assert_eq!((loaded, unphysical, links), (68, 18, 56));
}

#[test]
fn an_element_with_a_thousand_attributes_and_no_more() {
    let with = |count: usize| {
        let attributes = (0..count - 1).fold(String::new(), |all, k| all + &format!("\n a{k}='<!-- {k} -->'"));
        let text =
            format!("<robot>\n <link name='one'/>\n  <link name='other'{attributes}/></robot>").replace("<!--", "(");
        SceneBuilder::from_urdf(&text)
    };
    with(1_000).unwrap();
    for many in [1_001, 50_000] {
        assert_says(&with(many).unwrap_err().to_string(), &["line 3, column 3", "more than 1000 attributes"]);
    }
}
