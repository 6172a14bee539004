"""The report of a job."""


class Report(dict):
    """A dict whose keys are attributes too. `print(report)` shows what the command prints.

    `failure` says what the job found wrong, such as problems of a dataset that was checked; it is `None` if all is well.
    """

    def __init__(self, values, text, failure=None):
        super().__init__(values)
        self._text = text
        self.failure = failure

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
        return (Report, (dict(self), self._text, self.failure))
