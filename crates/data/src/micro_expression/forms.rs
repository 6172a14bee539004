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
pub static FORMS: [&Form; 10] =
    [&SAMM, &CASME2, &SMIC, &SAMM_LONG, &CASME3, &CASME3_MICRO, &CASME3_C, &CASME, &FOUR_DME, &DFME];

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

pub static SMIC_VIS: Form = Form {
    kind: "smic-vis",
    called: "SMIC-VIS's annotations (SMIC-VIS-E_annotation.xlsx)",
    columns: SMIC_COLUMNS,
};

pub static SMIC_NIR: Form = Form {
    kind: "smic-nir",
    called: "SMIC-NIR's annotations (SMIC-NIR-E_annotation.xlsx)",
    columns: SMIC_COLUMNS,
};

const SMIC_COLUMNS: &[&str] = &["Subject", "Filename", "OnsetF", "OffsetF", "FirstF", "Emotion"];

pub static CASME: Form = Form {
    kind: "casme",
    called: "CASME's annotations (casme.xlsx)",
    columns: &["Subject", "Filename", "OnsetF", "ApexF1", "OffsetF", "AU", "Emotion"],
};

/// Without a header row.
pub const CASME_SQUARED: &str = "CAS(ME)²'s annotations (CAS(ME)^2code_final.xlsx)";

/// Of whole videos.
pub static CASME3: Form = Form {
    kind: "casme3",
    called: "the expressions of CAS(ME)³, part A (CAS(ME)3_part_A_v2.xls)",
    columns: &["Subject", "Filename", "Onset", "Apex", "Offset", "AU", "Expression type"],
};

/// Of micro-expressions alone.
pub static CASME3_MICRO: Form = Form {
    kind: "casme3",
    called: "the micro-expressions of CAS(ME)³, part A (cas(me)3_part_A_ME_label_JpgIndex_v2.xlsx)",
    columns: &["Subject", "Filename", "Onset", "Apex", "Offset", "AU", "Objective class", "emotion"],
};

pub static CASME3_C: Form = Form {
    kind: "casme3-c",
    called: "the micro-expressions of CAS(ME)³, part C (CAS(ME)3_part_C_ME.xlsx)",
    columns: &["sub", "count", "onset", "offset", "au", "emotion"],
};

/// The columns are those of CASME II.
pub static MMEW: Form =
    Form { kind: "mmew", called: "MMEW's annotations (MMEW_Micro_Exp.xlsx)", columns: CASME2.columns };

pub static FOUR_DME: Form = Form {
    kind: "4dme",
    called: "4DME's annotations (4DME_Labelling_Micro_release v1.xlsx)",
    columns: &["sub_ID", "fold_name", "Emotion", "Onset", "Apex", "Offset", "AUs"],
};

pub static DFME: Form = Form {
    kind: "dfme",
    called: "DFME's annotations (training_full_with_AU.xlsx, testA_full_with_AU.xlsx, testB_full_with_AU.xlsx)",
    columns: &["Subject", "Filename", "OnsetFrame", "ApexFrame", "OffsetFrame", "Emotion", "Fps", "AU"],
};
