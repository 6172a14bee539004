//! Every dependency has one of the licences listed here, which all users of srflow can comply with.

use spdx::{Expression, LicenseReq, ParseMode};

/// Licences that only require a notice, and MPL-2.0, which covers the files of the dependency alone.
const ACCEPTED: [&str; 15] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "CDLA-Permissive-2.0",
    "ISC",
    "MIT",
    "MPL-2.0",
    "Unicode-3.0",
    "Unicode-DFS-2016",
    "Unlicense",
    "Zlib",
];

/// Packages whose manifest gives a file instead of a name, and what the file holds.
const READ_BY_HAND: [(&str, &str); 1] = [("cfg_block", "Apache-2.0")];

fn accepted(requirement: &LicenseReq) -> bool {
    ACCEPTED.contains(&requirement.to_string().as_str())
}

#[test]
fn every_dependency_has_an_accepted_licence() {
    let metadata = super::architecture::metadata(&["--locked", "--features", "srflow-cli/vulkan"]);
    let packages = metadata["packages"].as_array().expect("packages");
    assert!(packages.len() > 300, "the dependencies are listed, not srflow alone");
    let mut refused = Vec::new();
    for package in packages {
        let name = package["name"].as_str().expect("name");
        let by_hand = READ_BY_HAND.iter().find(|(package, _)| *package == name).map(|(_, licence)| *licence);
        let Some(licence) = package["license"].as_str().or(by_hand) else {
            refused.push(format!("{name}: no licence in its manifest"));
            continue;
        };
        match Expression::parse_mode(licence, ParseMode::LAX) {
            Ok(expression) if expression.evaluate(accepted) => {}
            Ok(_) => refused.push(format!("{name}: {licence}")),
            Err(error) => refused.push(format!("{name}: {error}")),
        }
    }
    assert!(refused.is_empty(), "licences that nobody has accepted:\n{}", refused.join("\n"));
}
