;;; anmech: the source of the manual in HTML, in which outputs and displays are formulas, in MathML.
;;;
;;; An output is a formula where it has an operation in it and is nothing that is typed: no text, and no object, which
;;; is its own constructor call.  Its variables are those that the example gives to coordinates(..), and those that it
;;; differentiates.  A @display of the manual is in ASCII; a line "@c TeX: .." in it says the same in LaTeX.
;;;
;;; Entry points: anmech_write_formulas(directory), WITH-FORMULAS.

(in-package :anmech)
(needs "session/examples" "session/latex" "session/manual" "session/mathml" "session/scope" "session/structures"
       "session/verbs")

(in-package :anmech-manual)

;;; Which outputs, and of what

(defun some-form (test form)
  "Whether TEST holds of FORM, or of a part of it."
  (or (funcall test form)
      (and (consp form) (some (lambda (part) (some-form test part)) (rest form)))))

(defun typed-p (form)
  (or (stringp form)
      (and (consp form) (or (anmech::shape-of form) (member (caar form) anmech::*verbs*)))))

(defun operation-p (form)
  (and (consp form)
       (not (anmech::variable-p form))
       (not (anmech::number-form-p form))
       (not (member (caar form) '(maxima::mlist maxima::mequal)))))

(defun shown-as-formula-p (value)
  (and (some-form #'operation-p value) (not (some-form #'typed-p value))))

(defun variables-of (steps)
  "What the inputs of STEPS give to coordinates(..), and what their outputs differentiate."
  (let ((variables '()))
    (flet ((visit (form)
             (when (consp form)
               (case (caar form)
                 (maxima::$coordinates
                  (when (operator-p (second form) 'maxima::mlist)
                    (setq variables (append (rest (second form)) variables))))
                 ((maxima::%derivative maxima::$diff) (push (second form) variables))))
             nil))
      (dolist (step steps)
        (some-form #'visit (anmech::parsed (input-text (example-step-lines step))))
        (when (recorded-value-text step) (some-form #'visit (value-of (recorded-value-text step))))))
    (remove-if-not #'anmech::variable-p (remove-duplicates variables :test #'equal))))

;;; The lines

(defun plain-in-texinfo (text)
  "TEXT, which is HTML, without what texinfo would take as its own."
  (with-output-to-string (out)
    (loop for letter across text
          do (if (find letter "@{}") (format out "&#~d;" (char-code letter)) (write-char letter out)))))

(defun html-lines (text)
  (mapcar (lambda (line) (make-source-line :text line))
          (append '("@html") (lines-of (plain-in-texinfo text)) '("@end html"))))

(defun formula-lines (step value variables)
  (html-lines (format nil "<span class=\"output\"><span class=\"label\">(%o~d)</span>~a</span>"
                      (example-step-index step)
                      (anmech::mathml-display (anmech::latex-display value variables 'maxima::$t)))))

(defun example-with-formulas (steps)
  (loop with variables = (variables-of steps)
        for step in steps
        append (example-step-lines step)
        append (if (recorded-value-text step) (value-lines step variables) (example-step-recorded step))))

(defun value-lines (step variables)
  "What was recorded of STEP: its value as a formula; else in one line's notation, unless it is an object."
  (let ((value (value-of (recorded-value-text step))) (printed (lines-of (printed-text step))))
    (cond ((shown-as-formula-p value) (append printed (formula-lines step value variables)))
          ((some-form #'typed-p value) (example-step-recorded step))
          (t (append printed (lines-of (format nil "(%o~d) ~a" (example-step-index step)
                                               (recorded-value-text step))))))))

(defun printed-text (step)
  "What the input of STEP printed, or of a picture nothing: it is not known where that begins."
  (if (example-step-picture-p step) "" (recorded-text step)))

(defun displays-as-formulas (lines)
  "LINES of a source, with each @display that says so in LaTeX as a formula."
  (let ((result '()) (held '()) (formulas '()))
    (dolist (line lines (reverse result))
      (cond ((or held (string= line "@display"))
             (push line held)
             (when (starts-with "@c TeX: " line) (push (subseq line 8) formulas))
             (when (string= line "@end display")
               (setq result (append (if formulas (reverse (formula-of-display (reverse formulas))) held) result)
                     held '() formulas '())))
            (t (push line result))))))

(defun formula-of-display (formulas)
  (mapcar #'texinfo-text
          (html-lines (format nil "<div class=\"formula\">~a</div>"
                              (anmech::mathml-display (anmech::latex-align formulas))))))

(defun with-formulas (file)
  "The lines of the source FILE, as makeinfo takes them for HTML."
  (displays-as-formulas (map-examples #'example-with-formulas file)))

(maxima::defmfun maxima::$anmech_write_formulas (directory)
  "anmech_write_formulas(directory): the sources of the manual for HTML; does not return."
  (carry-out "formulas"
             (lambda ()
               (dolist (file (manual-sources))
                 (write-lines (format nil "~a/~a" directory (file-namestring file)) (with-formulas file))))))
