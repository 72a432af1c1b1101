use super::*;

fn refused(name: &str, text: &str) -> String {
    ResultQuery::read([(name, text)]).unwrap_err().to_string()
}

#[test]
fn every_column_is_a_filter_an_order_and_a_field() {
    for column in COLUMNS {
        let name = column.name;
        ResultQuery::read([("sort", name), ("fields", name)]).unwrap();
        let (filter, text) = match column.kind {
            Kind::Id => (name.to_owned(), "3"),
            Kind::Text => (name.to_owned(), "x"),
            Kind::Word(words) => (name.to_owned(), words[0]),
            Kind::Real { .. } => (format!("{name}_min"), "-1.5e-3"),
            Kind::Time => (format!("{name}_max"), "2026-03-02"),
            Kind::Flag => (name.to_owned(), "all"),
            Kind::Tags => (name.to_owned(), "study 1"),
        };
        let query = ResultQuery::read([(filter.as_str(), text)]).unwrap();
        assert_eq!(query.conditions.len(), 1, "{name}");
    }
}

#[test]
fn a_refusal_names_what_was_probably_meant() {
    for (name, text, part) in [
        ("theta_r_deg_mni", "1", "expected one of"),
        ("theta_r_degs_min", "1", "did you mean `theta_r_deg_min`?"),
        ("verdicts", "fail", "did you mean `verdict`?"),
        ("verdict_min", "1", "there is no parameter"),
        ("verdict", "fial", "expected pass, fail, cannot-tell"),
        ("theta_r_deg", "10", "use theta_r_deg_min"),
        ("theta_r_deg_min", "NaN", "expected a number"),
        ("scan_id", "1.5", "expected a whole number"),
        ("since", "yesterday", "expected a time like"),
        ("sort", "-theta_r", "there is no column"),
        ("fields", "part,verdit", "did you mean `verdict`?"),
        ("limit", "1001", "expected 1 to 1000"),
        ("latest", "yes", "expected true or false"),
        ("search", "", "expected 1 to 200 characters"),
        ("format", "xml", "expected json or csv"),
        ("cursor", "7", "is not the next_cursor"),
        ("archived", "yes", "expected true, false or all"),
        ("tag", "a,b", "no comma"),
    ] {
        let said = refused(name, text);
        assert!(said.contains(part), "{name}={text}: {said}");
    }
    let twice = ResultQuery::read([("part", "a"), ("part", "b")]);
    assert!(twice.unwrap_err().to_string().contains("given twice"));
}

#[test]
fn a_cursor_is_read_back_and_belongs_to_its_order() {
    let sort = sort_of("-theta_r_deg").unwrap();
    for value in [
        Cell::Real(0.1 + 0.2),
        Cell::Null,
        Cell::Text("a".into()),
        Cell::Id(i64::MAX),
        Cell::Flag(true),
        Cell::Tags(vec!["a".into()]),
    ] {
        let cursor = Cursor::after(sort, value, 7, "even".into());
        assert_eq!(Cursor::read(&cursor.text()), Some(cursor.clone()));
        let text = cursor.text();
        let same = [("sort", "-theta_r_deg"), ("cursor", text.as_str())];
        assert_eq!(ResultQuery::read(same).unwrap().cursor, Some(cursor));
        let other = ResultQuery::read([("cursor", text.as_str())]).unwrap_err();
        assert!(other.to_string().contains("another order"), "{other}");
    }
}
