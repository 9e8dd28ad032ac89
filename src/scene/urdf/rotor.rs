//! Transmissions: actuators, and rotor inertia in the notation of Drake and others. Armature is ratio^2 * inertia.
//!
//! The reader accepts `<drake:rotor_inertia value="...">` and `<drake:gear_ratio value="...">` in the `<actuator>` of a
//! simple `<transmission>`, as Drake does, or in the `<joint>`. In an actuator it also accepts `<rotorInertia>`,
//! `<rotor_inertia>` and `<motorInertia>` with the value as text, `<gearRatio>` and `<gear_ratio>`, and
//! `<mechanicalReduction>` for the ratio in the actuator, the transmission or its joint. The default ratio is 1, the
//! default inertia 0. The actuators of the scene are motors with this ratio as gear.

use super::known::one_off;
use super::survey::{Findings, foreign};
use super::xml::{Source, plain_attribute, quoted};
use crate::error::{Error, number};
use crate::joints::JointKind;
use crate::scene::Actuator;
use crate::scene::description::JointDescription;
use roxmltree::Node;
use std::collections::{HashMap, HashSet};

/// Element names of the rotor inertia and the gear ratio; those of Drake first.
const INERTIAS: [&str; 4] = ["drake:rotor_inertia", "rotorInertia", "rotor_inertia", "motorInertia"];
const RATIOS: [&str; 5] =
    ["drake:gear_ratio", "gearRatio", "gear_ratio", "mechanicalReduction", "mechanical_reduction"];

/// Adds the rotor inertias to the armature of the joints, and returns the actuators.
///
/// # Errors
///
/// [`Error::Scene`] for a value that is not a number, or a negative inertia.
pub(super) fn read_transmissions(
    robot: &Node,
    source: &Source,
    joints: &mut [JointDescription],
    findings: &mut Findings,
) -> Result<Vec<Actuator>, Error> {
    let index: HashMap<String, usize> = joints.iter().enumerate().map(|(i, joint)| (joint.name.clone(), i)).collect();
    // Joints whose armature was given by `<dynamics armature>` or by elements of the joint.
    let mut said: HashSet<usize> =
        joints.iter().enumerate().filter(|(_, joint)| joint.armature != 0.0).map(|(i, _)| i).collect();
    let all = |tag: &'static str| {
        robot.children().filter(move |node| {
            node.tag_name().name() == tag && node.tag_name().namespace() == robot.tag_name().namespace()
        })
    };
    let reader = Reader { source };
    for node in all("joint") {
        let Some(rotor) = reader.rotor(&[node], &INERTIAS[..1], &RATIOS[..1], findings)? else { continue };
        let Some(&joint) = plain_attribute(&node, "name").and_then(|name| index.get(name)) else { continue };
        add(&rotor, joint, joints, &said, findings);
        said.insert(joint);
    }
    let (mut actuators_of_scene, mut taken) = (Vec::new(), HashSet::new());
    for node in all("transmission") {
        let parts =
            |tag: &'static str| node.children().filter(move |child| child.has_tag_name(tag)).collect::<Vec<_>>();
        let (actuators, driven) = (parts("actuator"), parts("joint"));
        for child in node.children().filter(Node::is_element) {
            let tag = child.tag_name().name();
            if ["actuator", "joint"].iter().any(|known| one_off(tag, known)) {
                findings.add(&format!("<{tag}> in a <transmission>"), &child, "");
            }
        }
        for &actuator in &actuators {
            let mut around = vec![actuator, node];
            around.extend(&driven);
            let joint = match driven[..] {
                [joint] if is_simple(&node) => plain_attribute(&joint, "name").and_then(|name| index.get(name)),
                _ => None,
            };
            let named = [actuator, node].iter().find_map(|of| plain_attribute(of, "name").map(str::to_owned));
            let at = actuators_of_scene.len();
            let mut name = named.unwrap_or_else(|| format!("actuator{at}"));
            if taken.contains(&name) {
                name = format!("{name}_{at}");
            }
            while !taken.insert(name.clone()) {
                name.push('_');
            }
            actuators_of_scene.push(motor(name, joint.map(|&at| &joints[at]), ratio_of(&around)));
            let Some(rotor) = reader.rotor(&around, &INERTIAS, &RATIOS, findings)? else { continue };
            match joint {
                Some(&joint) => add(&rotor, joint, joints, &said, findings),
                None => {
                    findings.add(
                        &rotor.what(),
                        &rotor.node,
                        "read in a SimpleTransmission of one joint of this file only",
                    );
                }
            }
        }
    }
    Ok(actuators_of_scene)
}

/// The motor of a joint, whose control range is that of the effort limit.
fn motor(name: String, joint: Option<&JointDescription>, gear: Option<f64>) -> Actuator {
    let joint = joint.filter(|joint| joint.kind != JointKind::Fixed && joint.kind.nv() == 1);
    let (Some(joint), Some(gear)) = (joint, gear) else {
        let reason = "whose transmission is not a SimpleTransmission of one joint with one degree of freedom";
        let reason = if joint.is_some() { "whose gear ratio is not a number" } else { reason };
        return Actuator { missing: Some(reason.to_owned()), ..Actuator::new(name, "", 1.0) };
    };
    let most = if gear == 0.0 { f64::INFINITY } else { joint.limits.effort / gear.abs() };
    Actuator { control: [-most, most], ..Actuator::new(name, joint.name.clone(), gear) }
}

/// The gear ratio in the elements, as for a rotor inertia, 1 without one; `None` if it is not a number.
fn ratio_of(elements: &[Node]) -> Option<f64> {
    let Some((_, node)) = named(elements, &RATIOS).next() else {
        return Some(1.0);
    };
    let text = plain_attribute(&node, "value").or_else(|| node.text()).unwrap_or_default();
    text.trim().parse().ok().filter(|ratio: &f64| ratio.is_finite())
}

/// Drake's rule: the type contains this word. A transmission without a type is simple.
fn is_simple(transmission: &Node) -> bool {
    let given = transmission.children().find(|child| child.has_tag_name("type")).and_then(|node| node.text());
    let given = given.or_else(|| plain_attribute(transmission, "type"));
    given.is_none_or(|text| text.contains("SimpleTransmission"))
}

/// Adds the rotor inertia to the joint, unless its armature is given already or it does not have one coordinate.
fn add(rotor: &Rotor, joint: usize, joints: &mut [JointDescription], said: &HashSet<usize>, findings: &mut Findings) {
    let joint_name = joints[joint].name.clone();
    let what = format!("{} for joint {}", rotor.what(), quoted(&joint_name));
    if said.contains(&joint) {
        findings.add(&what, &rotor.node, "its armature is given already");
    } else if joints[joint].kind == JointKind::Fixed || joints[joint].kind.nv() != 1 {
        findings.add(&what, &rotor.node, "read for joints of one coordinate only");
    } else {
        joints[joint].armature += rotor.inertia * rotor.ratio * rotor.ratio;
    }
}

/// A rotor with inertia, and the element that gives it.
struct Rotor<'a, 'd> {
    inertia: f64,
    ratio: f64,
    tag: String,
    node: Node<'a, 'd>,
}

impl Rotor<'_, '_> {
    fn what(&self) -> String {
        format!("<{}>", self.tag)
    }
}

struct Reader<'s> {
    source: &'s Source<'s>,
}

impl Reader<'_> {
    /// The rotor inertia in the first of the elements that has one, with the first ratio; `None` without an inertia.
    fn rotor<'a, 'd>(
        &self,
        elements: &[Node<'a, 'd>],
        inertias: &[&str],
        ratios: &[&str],
        findings: &mut Findings,
    ) -> Result<Option<Rotor<'a, 'd>>, Error> {
        let children =
            |element: Node<'a, 'd>| element.children().filter(Node::is_element).map(|child| (written(&child), child));
        let known = || inertias.iter().chain(ratios).copied();
        for (name, child) in children(elements[0]) {
            // The survey reports misspelled names without a prefix in a joint.
            let here = name.contains(':') || elements[0].has_tag_name("actuator");
            let close = |other: &str| one_off(&name, other) || local(&name) == local(other);
            if here && !known().any(|other| other == name) && known().any(close) {
                findings.add(&format!("<{name}> in <{}>", elements[0].tag_name().name()), &child, "");
            }
        }
        let Some((tag, node)) = named(&elements[..1], inertias).next() else {
            return Ok(None);
        };
        if children(elements[0]).filter(|(name, _)| inertias.contains(&name.as_str())).count() > 1 {
            findings.add(&format!("a second rotor inertia in addition to <{tag}>"), &node, "");
        }
        let inertia = self.value(&tag, &node, findings)?;
        if inertia < 0.0 {
            let found = format!("{} in <{tag}>", number(inertia));
            return Err(Error::scene(self.source.place_of(&node), found, "an inertia, zero or positive"));
        }
        let mut found = named(elements, ratios);
        let mut ratio = 1.0;
        if let Some((tag, node)) = found.next() {
            ratio = self.value(&tag, &node, findings)?;
        }
        for (tag, node) in found {
            let other = self.value(&tag, &node, findings)?;
            // Files for Drake contain a mechanicalReduction of 1 in addition to the ratio.
            if (other - 1.0).abs() > 0.0 && (other - ratio).abs() > 0.0 {
                findings.add(&format!("<{tag}>"), &node, &format!("the gear ratio {} is read", number(ratio)));
            }
        }
        Ok(Some(Rotor { inertia, ratio, tag, node }))
    }

    /// The attribute `value`, or else the text, as a finite number.
    fn value(&self, tag: &str, node: &Node, findings: &Findings) -> Result<f64, Error> {
        let text = plain_attribute(node, "value").or_else(|| node.text()).unwrap_or_default().trim();
        findings.refuse_expression(text, || format!("<{tag}>"), node)?;
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => {
                let found = format!("{} in <{tag}>", quoted(text));
                Err(Error::scene(
                    self.source.place_of(node),
                    found,
                    format!("<{tag} value=\"...\"> with a finite number"),
                ))
            }
        }
    }
}

/// The first child of each name in the elements, element by element in the order of the names, with its name.
fn named<'a, 'd>(elements: &[Node<'a, 'd>], names: &[&str]) -> impl Iterator<Item = (String, Node<'a, 'd>)> {
    elements.iter().flat_map(move |element| {
        names.iter().filter_map(move |&name| {
            let child = element.children().find(|child| child.is_element() && written(child) == name)?;
            Some((name.to_owned(), child))
        })
    })
}

/// A name without its prefix.
fn local(name: &str) -> &str {
    name.rsplit(':').next().unwrap_or(name)
}

/// The name of an element as written in the file, with its prefix.
fn written(node: &Node) -> String {
    match foreign(node) {
        Some((prefix, local)) => format!("{prefix}:{local}"),
        None => node.tag_name().name().to_owned(),
    }
}
