"""The report of a job."""


class Report(dict):
    """A dict whose keys are attributes too. `print(report)` shows what the command prints."""

    def __init__(self, values, text):
        super().__init__(values)
        self._text = text

    def __getattr__(self, name):
        try:
            return self[name]
        except KeyError:
            known = ", ".join(self)
            raise AttributeError(f"the report has no {name!r}; it has {known}") from None

    def __dir__(self):
        return [*super().__dir__(), *self]

    def __str__(self):
        return self._text.rstrip()

    def __reduce__(self):
        return (Report, (dict(self), self._text))
