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

/// Those of clips, one for each dataset.
pub static FORMS: [&Form; 3] = [&SAMM, &CASME2, &SMIC];

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
