//! view_planning
