from gscomplete.util.synonyms import _GROUP_OF, synonyms_of


def test_synonyms_are_mutual_and_nobodys_own():
    assert "sofa" in synonyms_of("couch")
    assert synonyms_of("unicorn") == ()
    for word, others in _GROUP_OF.items():
        assert word not in others
        assert all(word in synonyms_of(other) for other in others)
