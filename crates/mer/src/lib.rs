//! Micro-expression recognition: apex, optical strain, classifiers, leave-one-subject-out, metrics and tables.
