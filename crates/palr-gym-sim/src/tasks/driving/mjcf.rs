//! What the driving scenes have in common as MJCF: settings, materials, the car.

use std::fmt::Write;

use super::{CAR_HALF_LENGTH_M, FRAME_STEP_S, STEERING_LIMIT_RAD, WHEEL_RADIUS_M, WHEELBASE_M};

const AXLE_TRACK_M: f64 = 1.6;

pub(in crate::tasks) fn line(xml: &mut String, indent: usize, text: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(xml, "{:indent$}{text}", "");
}

/// Compiler, solver, room for `userdata` numbers, quality of pictures, defaults.
pub(in crate::tasks) fn settings(userdata: usize, xml: &mut String) {
    for text in [
        "<compiler angle=\"radian\" autolimits=\"true\"/>".to_owned(),
        format!(
            "<option timestep=\"{FRAME_STEP_S}\" integrator=\"implicitfast\" cone=\"elliptic\" impratio=\"5\"/>"
        ),
        format!("<size nuserdata=\"{userdata}\"/>"),
        "<statistic extent=\"20\" center=\"0 0 0\"/>".to_owned(),
    ] {
        line(xml, 2, &text);
    }
    line(xml, 2, "<visual>");
    for text in [
        "<global offwidth=\"640\" offheight=\"640\"/>",
        "<quality shadowsize=\"0\" offsamples=\"0\" numslices=\"8\" numstacks=\"5\" numquads=\"1\"/>",
        "<map znear=\"0.02\" zfar=\"12\" fogstart=\"3\" fogend=\"10\"/>",
        "<headlight ambient=\"0.35 0.35 0.35\" diffuse=\"0.15 0.15 0.15\" specular=\"0 0 0\"/>",
        "<rgba haze=\"0.75 0.82 0.9 1\" fog=\"0.75 0.82 0.9 1\"/>",
    ] {
        line(xml, 4, text);
    }
    line(xml, 2, "</visual>");
    line(xml, 2, "<default>");
    line(xml, 4, "<default class=\"visual\">");
    line(xml, 6, "<geom contype=\"0\" conaffinity=\"0\" mass=\"0\"/>");
    line(xml, 4, "</default>");
    line(xml, 2, "</default>");
}

/// Textures and materials that both scenes use.
pub(in crate::tasks) fn materials(xml: &mut String) {
    for text in [
        "<texture name=\"sky\" type=\"skybox\" builtin=\"gradient\" rgb1=\"0.35 0.55 0.85\" rgb2=\"0.85 0.9 0.95\" width=\"128\" height=\"768\"/>",
        "<texture name=\"grass\" type=\"2d\" builtin=\"flat\" mark=\"random\" random=\"0.25\" markrgb=\"0.28 0.42 0.2\" rgb1=\"0.2 0.36 0.15\" rgb2=\"0.2 0.36 0.15\" width=\"128\" height=\"128\"/>",
        "<texture name=\"asphalt\" type=\"2d\" builtin=\"flat\" mark=\"random\" random=\"0.2\" markrgb=\"0.36 0.36 0.37\" rgb1=\"0.28 0.28 0.3\" rgb2=\"0.28 0.28 0.3\" width=\"128\" height=\"128\"/>",
        "<material name=\"grass\" texture=\"grass\" texrepeat=\"0.12 0.12\" texuniform=\"true\" specular=\"0\"/>",
        "<material name=\"asphalt\" texture=\"asphalt\" specular=\"0\"/>",
        "<material name=\"edge\" rgba=\"0.92 0.92 0.9 1\" specular=\"0\"/>",
        "<material name=\"dash\" rgba=\"0.9 0.72 0.15 1\" specular=\"0\"/>",
        "<material name=\"tail_light\" rgba=\"0.5 0.05 0.05 1\" emission=\"0\"/>",
    ] {
        line(xml, 4, text);
    }
}

/// Hull, cabin and tail lights.
pub(in crate::tasks) fn hull(name: &str, color: &str, attributes: &str, xml: &mut String) {
    line(
        xml,
        6,
        &format!(
            "<geom name=\"{name}_hull\" type=\"box\" size=\"{CAR_HALF_LENGTH_M} 0.85 0.32\" pos=\"0 0 0.62\" rgba=\"{color}\" {attributes}/>"
        ),
    );
    line(
        xml,
        6,
        "<geom class=\"visual\" type=\"box\" size=\"1 0.75 0.28\" pos=\"-0.2 0 1.2\" rgba=\"0.1 0.12 0.15 1\"/>",
    );
    for y in ["0.55", "-0.55"] {
        line(
            xml,
            6,
            &format!(
                "<geom class=\"visual\" type=\"box\" size=\"0.03 0.22 0.1\" pos=\"-1.92 {y} 0.75\" material=\"tail_light\"/>"
            ),
        );
    }
}

/// The car that is driven, with its cameras `driver` and `chase`.
pub(in crate::tasks) fn car(xml: &mut String) {
    line(xml, 4, "<body name=\"car\" pos=\"0 0 0.02\">");
    line(xml, 6, "<freejoint name=\"root\"/>");
    hull("car", "0.85 0.85 0.85 1", "mass=\"900\" contype=\"0\" conaffinity=\"8\"", xml);
    for text in [
        "<camera name=\"driver\" pos=\"1.6 0 1.7\" xyaxes=\"0 -1 0 0 0 1\" fovy=\"48\"/>",
        "<camera name=\"chase\" pos=\"-7 0 3.2\" xyaxes=\"0 -1 0 0.3 0 1\" fovy=\"55\"/>",
        "<body name=\"column\" pos=\"0 0 0.6\">",
        "  <joint name=\"steer\" type=\"hinge\" axis=\"0 0 1\" range=\"-0.7 0.7\" damping=\"60\" armature=\"4\"/>",
        "  <inertial pos=\"0 0 0\" mass=\"2\" diaginertia=\"0.05 0.05 0.05\"/>",
        "</body>",
    ] {
        line(xml, 6, text);
    }
    let (front, side) = (WHEELBASE_M / 2.0, AXLE_TRACK_M / 2.0);
    for (name, x, y, steers) in [
        ("fl", front, side, true),
        ("fr", front, -side, true),
        ("rl", -front, side, false),
        ("rr", -front, -side, false),
    ] {
        line(xml, 6, &format!("<body name=\"{name}\" pos=\"{x} {y} {WHEEL_RADIUS_M}\">"));
        line(
            xml,
            8,
            &format!(
                "<joint name=\"{name}_suspension\" type=\"slide\" axis=\"0 0 1\" range=\"-0.15 0.15\" stiffness=\"45000\" damping=\"3500\" springref=\"-0.055\"/>"
            ),
        );
        if steers {
            line(
                xml,
                8,
                &format!(
                    "<joint name=\"{name}_steer\" type=\"hinge\" axis=\"0 0 1\" range=\"-0.75 0.75\" damping=\"30\" armature=\"2\"/>"
                ),
            );
        }
        line(xml, 8, "<inertial pos=\"0 0 0\" mass=\"12\" diaginertia=\"0.4 0.4 0.4\"/>");
        line(xml, 8, &format!("<body name=\"{name}_wheel\">"));
        line(
            xml,
            10,
            &format!(
                "<joint name=\"{name}_roll\" type=\"hinge\" axis=\"0 1 0\" damping=\"0.5\" armature=\"1\"/>"
            ),
        );
        // A sphere rolls over triangles' edges and flat ground alike; the cylinder is for the eye.
        line(
            xml,
            10,
            &format!(
                "<geom type=\"sphere\" size=\"{WHEEL_RADIUS_M}\" mass=\"18\" rgba=\"0 0 0 0\" contype=\"4\" conaffinity=\"1\" condim=\"3\" friction=\"1 0.005 0.0001\" priority=\"1\"/>"
            ),
        );
        line(
            xml,
            10,
            &format!(
                "<geom class=\"visual\" type=\"cylinder\" size=\"{WHEEL_RADIUS_M} 0.1\" euler=\"1.5708 0 0\" rgba=\"0.08 0.08 0.08 1\"/>"
            ),
        );
        line(xml, 8, "</body>");
        line(xml, 6, "</body>");
    }
    line(xml, 4, "</body>");
}

/// Ackermann steering, drive train and brakes.
pub(in crate::tasks) fn drive(xml: &mut String) {
    // To first order the inner wheel turns by a (1 + a T / 2 L), the outer by a (1 - a T / 2 L).
    let ackermann = AXLE_TRACK_M / (2.0 * WHEELBASE_M);
    line(xml, 2, "<equality>");
    for (name, sign) in [("fl", 1.0), ("fr", -1.0)] {
        line(
            xml,
            4,
            &format!(
                "<joint joint1=\"{name}_steer\" joint2=\"steer\" polycoef=\"0 1 {:.4} 0 0\" solref=\"0.02 1\"/>",
                sign * ackermann,
            ),
        );
    }
    line(xml, 2, "</equality>");
    line(xml, 2, "<actuator>");
    for name in ["rl", "rr"] {
        line(
            xml,
            4,
            &format!(
                "<general name=\"throttle_{name}\" joint=\"{name}_roll\" dyntype=\"filterexact\" dynprm=\"0.25\" gainprm=\"520\" biastype=\"affine\" biasprm=\"0 0 -12\" ctrlrange=\"0 1\"/>"
            ),
        );
    }
    for name in ["fl", "fr", "rl", "rr"] {
        line(
            xml,
            4,
            &format!(
                "<damper name=\"brake_{name}\" joint=\"{name}_roll\" kv=\"100\" ctrlrange=\"0 1\" forcerange=\"-500 500\"/>"
            ),
        );
    }
    line(
        xml,
        4,
        &format!(
            "<general name=\"steer\" joint=\"steer\" dyntype=\"filterexact\" dynprm=\"0.2\" gainprm=\"3000\" biastype=\"affine\" biasprm=\"0 -3000 -250\" ctrlrange=\"-{STEERING_LIMIT_RAD} {STEERING_LIMIT_RAD}\"/>"
        ),
    );
    line(xml, 2, "</actuator>");
}
