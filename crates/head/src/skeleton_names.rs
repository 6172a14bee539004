//! What joints are for, by their names in published models.

use crate::JointRole;

/// The role of each joint of a skeleton whose first joint is the root of the others. `head`, or `neck` where there is none, moves
/// the head; eyes and jaw are recognized by these words and their side (`left_eye`, `eye_L`, `LeftEye`, `lEye`, `mixamorig:LeftEye`),
/// except for parts of them such as lids. No role is given twice.
pub(crate) fn roles(names: &[String]) -> Vec<Option<JointRole>> {
    let plain: Vec<String> = names.iter().map(|name| plain(name)).collect();
    let find =
        |fits: &dyn Fn(&str) -> bool| plain.iter().skip(1).position(|name| fits(name)).map(|at| at + 1);
    let head = find(&|name| name == "head").or_else(|| find(&|name| name == "neck"));
    let neck =
        head.or_else(|| find(&|name| name.ends_with("head"))).or_else(|| find(&|name| name.contains("neck")));
    let jaw =
        find(&|name| name == "jaw").or_else(|| find(&|name| name.contains("jaw") && !name.contains("end")));
    let eye = |side: &str, letter: &str| {
        let is_eye = |name: &str| {
            let rest = name.strip_prefix(side).or_else(|| name.strip_suffix(side));
            let rest = rest.or_else(|| name.strip_prefix(letter)).or_else(|| name.strip_suffix(letter));
            matches!(rest, Some("eye" | "eyeball" | "eyejoint" | "eyebone"))
        };
        find(&is_eye)
    };
    let mut roles = vec![None; names.len()];
    let found = [
        (JointRole::Neck, neck),
        (JointRole::Jaw, jaw),
        (JointRole::LeftEye, eye("left", "l")),
        (JointRole::RightEye, eye("right", "r")),
    ];
    if let Some(root) = roles.first_mut() {
        *root = Some(JointRole::Root);
    }
    for (role, joint) in found {
        if let Some(place) = joint.and_then(|joint| roles.get_mut(joint))
            && place.is_none()
        {
            *place = Some(role);
        }
    }
    roles
}

/// Lower-case letters and digits of a name, without the namespace before a colon.
fn plain(name: &str) -> String {
    let name = name.rsplit(':').next().unwrap_or_default();
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_are_recognized_by_the_names_of_published_models() {
        use JointRole::{Jaw, LeftEye, Neck, RightEye, Root};
        let of = |names: &[&str]| roles(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
        let expected = [Some(Root), Some(Neck), Some(LeftEye), Some(RightEye)];
        assert_eq!(of(&["neck", "head", "left_eye", "right_eye"]), expected);
        assert_eq!(of(&["root", "Neck", "Eye_L", "Eye.R"]), expected);
        assert_eq!(
            of(&["mixamorig:Hips", "mixamorig:Head", "mixamorig:LeftEye", "mixamorig:RightEye"]),
            expected
        );
        assert_eq!(
            of(&["Hips", "Neck", "Head", "Jaw", "LeftEyeLid"]),
            [Some(Root), None, Some(Neck), Some(Jaw), None]
        );
        assert_eq!(
            of(&["head", "jaw_end", "jaw_main", "lEye"]),
            [Some(Root), None, Some(Jaw), Some(LeftEye)]
        );
        assert_eq!(of(&[]), []);
    }
}
