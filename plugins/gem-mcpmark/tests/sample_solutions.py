"""For each sample task SQL that solves it, and SQL that comes near and must not count."""

from __future__ import annotations

_OVERDUE = """
CREATE TABLE overdue AS
SELECT loan_id, members.name AS member, tools.name AS tool, DATE '2025-06-30' - due_on AS days_late
FROM loans JOIN members USING (member_id) JOIN tools USING (tool_id)
WHERE due_on < DATE '2025-06-30' AND returned_on IS NULL
"""
_DUPLICATES = """
CREATE TEMPORARY TABLE same AS
SELECT member_id, min(member_id) OVER (PARTITION BY lower(trim(email))) AS kept FROM members;
UPDATE loans SET member_id = kept FROM same WHERE same.member_id = loans.member_id;
DELETE FROM members USING same WHERE same.member_id = members.member_id AND kept <> same.member_id;
UPDATE members SET email = lower(trim(email));
"""
_FEES = """
INSERT INTO fees (loan_id, amount)
SELECT loan_id, least((returned_on - due_on) * 0.50, price / 10)
FROM loans JOIN tools USING (tool_id)
WHERE returned_on > due_on AND loan_id NOT IN (SELECT loan_id FROM fees)
"""
_RANKING = """
CREATE VIEW tool_ranking AS
SELECT category, tools.name AS tool, count(loan_id) AS times_lent,
       rank() OVER (PARTITION BY category ORDER BY count(loan_id) DESC) AS place
FROM tools LEFT JOIN loans USING (tool_id) GROUP BY tool_id
"""
_CONDITIONS = """
UPDATE tools SET condition = lower(trim(condition));
UPDATE tools SET condition = CASE condition WHEN 'as new' THEN 'new' WHEN 'used' THEN 'worn' ELSE condition END;
"""
_RETURNS = """
UPDATE loans SET returned_on = later.lent_on
FROM (SELECT loan_id, lead(lent_on) OVER (PARTITION BY tool_id ORDER BY lent_on) AS lent_on FROM loans) AS later
WHERE later.loan_id = loans.loan_id AND returned_on IS NULL AND later.lent_on IS NOT NULL;
"""
_DESK = """
CREATE ROLE front_desk;
GRANT SELECT ON tools, loans TO front_desk;
GRANT INSERT, UPDATE (returned_on) ON loans TO front_desk;
CREATE VIEW member_names AS SELECT member_id, name FROM members;
GRANT SELECT ON member_names TO front_desk;
"""
_ARCHIVE = """
CREATE TABLE loans_archive (LIKE loans);
CREATE FUNCTION archive_loans(before date) RETURNS integer LANGUAGE sql AS $$
    WITH moved AS (
        DELETE FROM loans
        WHERE returned_on < before AND loan_id NOT IN (SELECT loan_id FROM fees)
        RETURNING *
    ), kept AS (INSERT INTO loans_archive SELECT * FROM moved RETURNING 1)
    SELECT count(*)::integer FROM kept
$$
"""

SOLUTIONS = {
    "lending/overdue_list": (_OVERDUE, _OVERDUE.replace(" AND returned_on IS NULL", "")),
    # Without the rule that is to hold from now on; or without regard to case.
    "lending/duplicate_members": (f"{_DUPLICATES} CREATE UNIQUE INDEX ON members (lower(email))", _DUPLICATES),
    "lending/missing_fees": (_FEES, _FEES.replace(", price / 10", "")),
    "lending/category_ranking": (_RANKING, _RANKING.replace("rank()", "row_number()")),
    "lending/tool_conditions": (
        f"{_CONDITIONS} ALTER TABLE tools ADD CHECK (condition IN ('new', 'good', 'worn', 'broken'))",
        _CONDITIONS,
    ),
    "lending/one_loan_at_a_time": (
        f"{_RETURNS} CREATE UNIQUE INDEX ON loans (tool_id) WHERE returned_on IS NULL",
        _RETURNS,
    ),
    "lending/front_desk_role": (_DESK, _DESK.replace("UPDATE (returned_on)", "UPDATE")),
    "lending/archive_function": (_ARCHIVE, _ARCHIVE.replace("RETURNING *", "AND tool_id < 20 RETURNING *")),
}  # fmt: skip
