//! The published spreadsheets.

/// The format of a published spreadsheet.
#[derive(Debug)]
pub struct Form {
    pub kind: &'static str,
    /// Description and file name, for messages.
    pub called: &'static str,
    /// Columns that the header row must contain, exactly as spelled.
    pub columns: &'static [&'static str],
}

/// Those that a user may mistake for one another.
pub static FORMS: [&Form; 5] = [&SAMM, &CASME2, &SMIC, &SAMM_LONG, &CASME3];

pub static SAMM: Form = Form {
    kind: "samm",
    called: "SAMM's annotations (SAMM_Micro_FACS_Codes_v2.xlsx)",
    columns: &[
        "Subject",
        "Filename",
        "Inducement Code",
        "Onset Frame",
        "Apex Frame",
        "Offset Frame",
        "Action Units",
        "Estimated Emotion",
    ],
};

pub static CASME2: Form = Form {
    kind: "casme2",
    called: "CASME II's annotations (CASME2-coding-20140508.xlsx)",
    columns: &[
        "Subject",
        "Filename",
        "OnsetFrame",
        "ApexFrame",
        "OffsetFrame",
        "Action Units",
        "Estimated Emotion",
    ],
};

pub static CASME2_OBJECTIVE: Form = Form {
    kind: "casme2",
    called: "CASME II's objective classes (CASME2-ObjectiveClasses.xlsx)",
    columns: &["Subject", "Filename", "Objective Class"],
};

pub static SMIC: Form = Form {
    kind: "smic",
    called: "SMIC-HS's annotations (SMIC-HS-E_annotation.xlsx)",
    columns: &["Subject", "Filename", "OnsetF", "OffsetF", "Onset2F", "Emotion"],
};

pub static SAMM_LONG: Form = Form {
    kind: "samm-long",
    called: "SAMM Long Videos' expressions (SAMM_LongVideos_V2_Release.xlsx)",
    columns: &["Subject", "Filename", "Onset", "Apex", "Offset", "Type", "Action Units"],
};

pub static CASME3: Form = Form {
    kind: "casme3",
    called: "the expressions of CAS(ME)³, part A (CAS(ME)3_part_A_v2.xls, saved as .xlsx)",
    columns: &["Subject", "Filename", "Onset", "Apex", "Offset", "AU", "Expression type"],
};
