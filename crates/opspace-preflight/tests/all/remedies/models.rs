//! Remedies for the values of a URDF: each is a change of the text at the place that a warning names.

use opspace_experiment::Code;
use opspace_model::{Model, UrdfOptions, model_warnings};

/// Arm of two links without warnings; each test changes a part of it.
const ARM: &str = r#"<robot name="arm">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 0.15"/><mass value="3"/><inertia ixx="0.03" iyy="0.03" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 0.1"/><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="3" effort="40"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="4" effort="20"/></joint>
</robot>"#;

/// Codes of the warnings about a URDF.
fn codes(urdf: &str) -> Vec<&'static str> {
    let loaded = Model::from_urdf(urdf).unwrap_or_else(|error| panic!("{error}: {urdf}"));
    let of_file = loaded.warnings.iter().map(|warning| warning.kind().code());
    of_file.chain(model_warnings(&loaded.model).iter().map(|warning| warning.code())).collect()
}

/// Checks that a mistake is named, and that each remedy removes its code without another one. `advice` is in the page.
fn is_helped(code: Code, right: &str, wrong: &str, remedies: &[&str], advice: &str) {
    assert_eq!(codes(ARM), [""; 0]);
    assert!(ARM.contains(right), "{right}");
    assert!(code.page().split_once("**What to do.**").unwrap().1.contains(advice), "{code}: {advice}");
    assert!(
        codes(&ARM.replace(right, wrong)).contains(&code.name()),
        "{code}: {:?}",
        codes(&ARM.replace(right, wrong))
    );
    for remedy in remedies {
        assert_eq!(codes(&ARM.replace(right, remedy)), [""; 0], "{code}: {remedy}");
    }
}

const MOMENTS: &str = r#"ixx="0.02" iyy="0.02" izz="0.003""#;

pub fn impossible_inertia(code: Code) {
    is_helped(code, MOMENTS, r#"ixx="0.002" iyy="0.002" izz="0.02""#, &[MOMENTS], "about the centre of mass");
}

pub fn fixed_link_inertia(code: Code) {
    let base = |moments: &str| {
        format!(
            "<link name=\"base\"><inertial><mass value=\"1\"/><inertia {moments} ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>"
        )
    };
    let wrong = base(r#"ixx="0.01" iyy="0.01" izz="-0.01""#);
    is_helped(code, "<link name=\"base\"/>", &wrong, &[&base(MOMENTS)], "correct the URDF");
}

const RANGE: &str = r#"type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-1" upper="1""#;

/// The joint at the elbow, of a type and with a range.
fn elbow(kind: &str, range: &str) -> String {
    RANGE.replace("revolute", kind).replace(r#"lower="-1" upper="1""#, range)
}

pub fn equal_limits(code: Code) {
    let wrong = elbow("revolute", r#"lower="0" upper="0""#);
    is_helped(
        code,
        RANGE,
        &wrong,
        &[&elbow("fixed", r#"lower="0" upper="0""#), RANGE],
        "Make it a fixed joint, or correct the limits",
    );
}

pub fn far_limit(code: Code) {
    let wrong = elbow("revolute", r#"lower="-1e16" upper="1e16""#);
    is_helped(code, RANGE, &wrong, &[&elbow("continuous", ""), RANGE], "declare the joint `continuous`");
}

pub fn wide_range(code: Code) {
    let wrong = elbow("revolute", r#"lower="-180" upper="180""#);
    is_helped(
        code,
        RANGE,
        &wrong,
        &[&elbow("continuous", ""), RANGE],
        "Give rad and m, or make the joint continuous",
    );
}

const LIMIT: &str = r#"velocity="4" effort="20""#;

pub fn zero_limit(code: Code) {
    is_helped(code, LIMIT, r#"velocity="4" effort="0""#, &[LIMIT], "the value of the data sheet");
    // Without the attribute no limit is known, which is another warning.
    assert_eq!(codes(&ARM.replace(LIMIT, r#"velocity="4""#)), ["no-limit"]);
}

pub fn negative_limit(code: Code) {
    is_helped(code, LIMIT, r#"velocity="-1" effort="20""#, &[LIMIT], "the value of the data sheet");
}

pub fn no_limit(code: Code) {
    is_helped(code, LIMIT, r#"velocity="4""#, &[LIMIT], "from the data sheet");
}

pub fn undeclared_prefix(code: Code) {
    let (robot, plugin) = ("<robot name=\"arm\">", "<controller:plugin name=\"p3d\"/>");
    let declared = format!("<robot name=\"arm\" xmlns:controller=\"http://example.org/controller\">{plugin}");
    is_helped(
        code,
        robot,
        &format!("{robot}{plugin}"),
        &[&declared, robot],
        "xmlns:controller=\"http://example.org/controller\"",
    );
}

pub fn far_centre(code: Code) {
    let centre = r#"<origin xyz="0 0 0.1"/>"#;
    is_helped(code, centre, r#"<origin xyz="0 0 100"/>"#, &[centre], "in m");
}

pub fn small_inertia(code: Code) {
    is_helped(code, MOMENTS, r#"ixx="1e-8" iyy="1e-8" izz="1e-8""#, &[MOMENTS], "kg m²");
}

pub fn large_inertia(code: Code) {
    is_helped(code, MOMENTS, r#"ixx="5" iyy="5" izz="5""#, &[MOMENTS], "placeholders");
}

pub fn unequal_masses(code: Code) {
    let (mass, placeholder) = (
        r#"<mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.003""#,
        r#"<mass value="1e-3"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6""#,
    );
    assert!(code.page().contains("attach a placeholder link by a fixed joint"));
    is_helped(code, mass, placeholder, &[mass], "Give both in kg");
    let fixed = ARM.replace(mass, placeholder).replace(RANGE, &elbow("fixed", r#"lower="-1" upper="1""#));
    assert_eq!(codes(&fixed), [""; 0]);
}

pub fn ignored_mimic(code: Code) {
    let mimics =
        ARM.replace(RANGE, &RANGE.replace("<axis", "<mimic joint=\"shoulder\" multiplier=\"0.5\"/><axis"));
    assert!(codes(&mimics).contains(&code.name()), "{:?}", codes(&mimics));
    assert!(code.page().contains("enforce_mimic = true"));
    let options = UrdfOptions { enforce_mimic: true, ..UrdfOptions::default() };
    let folded = Model::from_urdf_with(&mimics, options).unwrap();
    assert_eq!((folded.warnings.len(), folded.model.n()), (0, 1));
}
