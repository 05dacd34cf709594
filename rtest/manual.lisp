;;;; manual.lisp: what rtest_manual.mac asks about the manual, its examples, its index, and the tests themselves.
;;;;
;;;;   manual_entries()          the verbs that have an entry, in the order of the manual
;;;;   manual_signature(verb)    what anmech_signature(verb) should be, as its entry says; false if there is none
;;;;   manual_defaults(verb)     options whose default in the entry is wrong, or not shown though it can be written down
;;;;   manual_failures(part)     [file, line, input, recorded, found] of each input, in the manual and in README.md,
;;;;                             whose output no longer holds; of every PARTth example
;;;;   manual_spoilt_formulas()  formulas of the HTML whose tags are not in pairs, or that show a command of LaTeX
;;;;   verbs_called()            the verbs that some file of tests calls in an input
;;;;   manual_missing_in_info()  lines of examples, and entries, that the info file does not hold
;;;;   chinese_page_is_fresh()   whether README.zh.md shows what README.md does
;;;;   manual_index_is_fresh()   whether the index is the one that make doc would write for the info file
;;;;
;;;; An output is compared as a value: the recorded text is parsed, and must be equal, or differ by a provable zero,
;;;; part by part in lists, equations, matrices and systems; floats may differ by 1e-5 of their size, and by 1e-9,
;;;; which is less than the examples print or promise.  Errors and printed text are compared as text, spaces and
;;;; parentheses apart.

(in-package :anmech-tests)

(maxima::mfuncall 'maxima::$anmech_need "session/manual_formulas.lisp")

(defun manual-lines ()
  (mapcan #'anmech-manual::file-lines (anmech-manual::manual-sources)))

(defun maxima-list (items)
  (cons '(maxima::mlist maxima::simp) items))

;;; Entries

(defun definition-texts (lines)
  "What stands after @deffn {Function} in LINES, continued over lines that end with @."
  (loop while lines
        for line = (pop lines)
        when (anmech::starts-with "@deffn " line)
          collect (loop for end = (1- (length line))
                        while (char= (char line end) #\@)
                        do (setq line (concatenate 'string (subseq line 0 end) (pop lines)))
                        finally (return (subseq line (1+ (position #\} line)))))))

(defvar *entries* '())

(defun entries ()
  "The entries of the manual, as calls name(parameter, ..., [option, option = default, ...])."
  (or *entries*
      (setq *entries* (mapcar (lambda (text) (anmech::parsed (concatenate 'string text ";")))
                              (definition-texts (manual-lines))))))

(defun entry-of (verb)
  (find verb (entries) :key #'caar))

(defun entry-options (entry)
  "A list of (name) or (name default)."
  (let ((tail (first (last entry))))
    (when (anmech::operator-p tail 'maxima::mlist)
      (mapcar (lambda (option)
                (if (anmech::operator-p option 'maxima::mequal) (rest option) (list option)))
              (rest tail)))))

(defun entry-parameters (entry)
  (remove-if (lambda (argument) (anmech::operator-p argument 'maxima::mlist)) (rest entry)))

(defun plain-default (form)
  "What a default in the source of a module stands for, if a user could write it: (value), otherwise nil."
  (cond ((member form '(nil maxima::$auto)) nil)
        ((anmech::operator-p form 'maxima::mquote) (plain-default (second form)))
        ((or (atom form) (anmech::operator-p form 'maxima::mlist)) (list form))))

(defun same-default-p (shown option)
  "SHOWN is (name) or (name default), OPTION a list (name default) of a definition."
  (let ((plain (plain-default (second option))))
    (cond ((rest shown) (maxima::alike1 (second shown)
                                        (if plain (first plain) (second (second option)))))
          (t (null plain)))))

;;; Examples

(defun examples-of (file)
  "The steps of all examples in FILE: a list of lists."
  (let ((examples '()))
    (anmech-manual::map-examples (lambda (steps) (push steps examples) '()) file)
    (reverse examples)))

(defun close-p (a b)
  (<= (abs (- a b)) (max 1d-9 (* 1d-5 (max (abs a) (abs b))))))

(defun same-value-p (a b)
  (cond ((or (anmech::operator-p a 'maxima::mrat) (anmech::operator-p b 'maxima::mrat))
         (same-value-p (maxima::$ratdisrep a) (maxima::$ratdisrep b)))
        ((and (numberp a) (numberp b)) (close-p a b))
        ((or (stringp a) (stringp b)) (equal a b))
        ((maxima::alike1 a b) t)
        ((same-parts-p a b) t)
        ((or (container-p a) (container-p b) (member a '(t nil)) (member b '(t nil))) nil)
        (t (member (maxima::mfuncall 'maxima::$is_zero (maxima::sub a b)) '(t maxima::$probable)))))

(defun same-parts-p (a b)
  (and (consp a) (consp b) (eq (caar a) (caar b)) (= (length a) (length b)) (every #'same-value-p (rest a) (rest b))))

(defun container-p (form)
  (or (anmech::shape-of form)
      (and (consp form) (member (caar form) '(maxima::mlist maxima::mequal maxima::$matrix)))))

(defun same-text-p (a b)
  (flet ((bare (text) (remove-if (lambda (letter) (find letter '(#\Space #\Newline #\( #\)))) text)))
    (string= (bare a) (bare b))))

(defun step-holds-p (step outcome)
  (let ((value-text (anmech-manual::recorded-value-text step)))
    (and (or (anmech-manual::example-step-picture-p step)
             (same-text-p (anmech-manual::recorded-text step) (anmech-manual::outcome-text outcome)))
         (if (or (anmech-manual::outcome-silent-p outcome) (anmech-manual::outcome-error-p outcome))
             (null value-text)
             (and value-text
                  (same-value-p (anmech-manual::value-of value-text) (anmech-manual::outcome-value outcome)))))))

(defun found-text (outcome)
  (if (or (anmech-manual::outcome-error-p outcome) (anmech-manual::outcome-silent-p outcome))
      (anmech-manual::outcome-text outcome)
      (concatenate 'string (anmech-manual::outcome-text outcome) (text-of (anmech-manual::outcome-value outcome)))))

(defun example-failures (steps file)
  (anmech-manual::start-example)
  (loop for step in steps
        for outcome = (anmech-manual::step-outcome step)
        unless (step-holds-p step outcome)
          collect (maxima-list (list (file-namestring file)
                                     (anmech-manual::example-step-number step)
                                     (anmech-manual::input-text (anmech-manual::example-step-lines step))
                                     (anmech-manual::joined (anmech-manual::example-step-recorded step))
                                     (found-text outcome)))))

;;; Formulas in HTML

(defun sources-with-formulas ()
  "Their lines."
  (loop for file in (anmech-manual::manual-sources) append (anmech-manual::with-formulas file)))

(defun formulas-in (lines)
  "What stands between @html and @end html, each a text."
  (loop while lines
        for line = (pop lines)
        when (string= line "@html")
          collect (anmech-manual::joined (loop for inside = (pop lines)
                                               until (string= inside "@end html") collect inside))))

(defun tags-in-pairs-p (text)
  (let ((open '()))
    (loop for start = (position #\< text) then (position #\< text :start (1+ start))
          while start
          do (let* ((end (position #\> text :start start))
                    (tag (subseq text (1+ start) end))
                    (name (subseq tag 0 (position #\Space tag))))
               (cond ((char= (char tag (1- (length tag))) #\/))
                     ((char/= (char tag 0) #\/) (push name open))
                     ((string= (subseq name 1) (first open)) (pop open))
                     (t (return-from tags-in-pairs-p nil)))))
    (null open)))

;;; The tests

(defun test-inputs (file)
  (with-open-file (stream file)
    (loop for input = (next-expression stream)
          while input
          collect (third input)
          do (next-expression stream))))

(defun operators-in (form)
  (and (consp form)
       (append (and (consp (first form)) (symbolp (caar form)) (list (caar form)))
               (loop for part in (rest form) append (operators-in part)))))

;;; The layer that Maxima sees

(in-package :maxima)

(defmfun $manual_entries ()
  (anmech-tests::maxima-list (mapcar #'caar (anmech-tests::entries))))

(defmfun $manual_signature (verb)
  (let ((entry (anmech-tests::entry-of verb)))
    (and entry
         (anmech-tests::maxima-list
          (list (anmech-tests::maxima-list (anmech-tests::entry-parameters entry))
                (anmech-tests::maxima-list (mapcar #'first (anmech-tests::entry-options entry))))))))

(defmfun $manual_defaults (verb)
  (let ((shown (anmech-tests::entry-options (anmech-tests::entry-of verb))))
    (anmech-tests::maxima-list
     (loop for option in (anmech::definition-options (anmech::verb-definition verb))
           for there = (assoc (first option) shown)
           unless (and there (anmech-tests::same-default-p there option))
             collect (first option)))))

(defmfun $manual_failures (part)
  (anmech-manual::with-examples
    (anmech-tests::maxima-list
     (loop for file in (anmech-manual::files-with-examples)
           append (loop for steps in (anmech-tests::examples-of file)
                        for place from 0
                        when (zerop (mod place part))
                          append (anmech-tests::example-failures steps file))))))

(defmfun $manual_spoilt_formulas ()
  (let ((formulas (anmech-tests::formulas-in (anmech-tests::sources-with-formulas))))
    (anmech-tests::maxima-list
     (if (null formulas)
         (list "no formulas at all")
         (remove-if (lambda (formula) (and (anmech-tests::tags-in-pairs-p formula) (not (find #\\ formula))))
                    formulas)))))

(defmfun $verbs_called ()
  (let ((called (loop for file in (directory (concatenate 'string anmech-tests::*root* "rtest/rtest_*.mac"))
                      append (loop for input in (anmech-tests::test-inputs file)
                                   append (anmech-tests::operators-in input)))))
    (anmech-tests::maxima-list (intersection anmech::*verbs* called))))

(defmfun $manual_missing_in_info ()
  (let* ((lines (anmech-manual::file-lines (anmech-manual::manual-file "anmech.info")))
         (held (mapcar #'anmech-manual::trimmed lines))
         (defined (loop for line in lines
                        when (anmech::starts-with anmech-manual::+heading+ line)
                          collect (anmech-manual::between anmech-manual::+heading+ " " line)))
         (wanted (loop for steps in (mapcan #'anmech-tests::examples-of (anmech-manual::manual-sources))
                       append (loop for step in steps
                                    append (append (anmech-manual::example-step-lines step)
                                                   (anmech-manual::example-step-recorded step))))))
    (anmech-tests::maxima-list
     (append (loop for line in wanted
                   for text = (anmech-manual::trimmed line)
                   unless (or (anmech-manual::comment-line-p line) (member text held :test #'string=))
                     collect text)
             (set-difference (mapcar (lambda (entry) (anmech::plain-name (caar entry))) (anmech-tests::entries)) defined
                             :test #'string=)))))

(defmfun $chinese_page_is_fresh ()
  (equal (anmech-manual::file-lines (anmech-manual::chinese-page)) (anmech-manual::chinese-lines)))

(defmfun $manual_index_is_fresh ()
  (equal (anmech-manual::index-lines (anmech-manual::manual-file "anmech.info"))
         (anmech-manual::file-lines (anmech-manual::manual-file "anmech-index.lisp"))))
