;;; anmech: expressions as lines of a script that reads back as what it was made of.
;;;
;;; Maxima's own one-line notation does nearly that: floats lose their last digits, and a name that is a word of
;;; Maxima's language is no name when it is read.  So floats are written to the last bit here, and every text is read
;;; again, without being evaluated, before it is handed out.
;;;
;;; Entry points: DECIMAL-PARTS, BROKEN-TEXT, LINES-IN; anmech_script_text, anmech_shown_lines, anmech_own_facts.

(in-package :anmech)
(needs "session/scope" "session/structures" "session/texts")

;;; Floats to the last bit

(defun decimal-parts (number)
  "Integers m and e: NUMBER, a positive double, is the double next to m*10^e, with the fewest digits that do."
  (let* ((exact (rational number)) (size (decimal-size exact)))
    (loop for digits from 1 to 17
          for e = (- size digits)
          for m = (round (* exact (expt 10 (- e))))
          when (or (= digits 17) (nearest-p (* m (expt 10 e)) number)) do (return (values m e)))))

(defun decimal-size (exact)
  "The exponent of the smallest power of ten above EXACT, or one more."
  (let ((guess (ceiling (* (- (integer-length (numerator exact)) (integer-length (denominator exact))) 30103) 100000)))
    (loop while (>= exact (expt 10 guess)) do (incf guess))
    guess))

(defun nearest-p (decimal number)
  "Whether the rational DECIMAL is nearer to the double NUMBER than to its neighbours."
  (multiple-value-bind (mantissa exponent) (integer-decode-float number)
    (declare (ignore mantissa))
    (< (abs (- decimal (rational number))) (expt 2 (1- exponent)))))

(defun float-text (number)
  "NUMBER, not negative, as it is typed."
  (if (zerop number)
      "0.0"
      (multiple-value-bind (m e) (decimal-parts number)
        (let* ((digits (format nil "~d" m)) (power (+ e (length digits) -1)))
          (flet ((zeros (count) (make-string (max 0 count) :initial-element #\0)))
            (cond ((< -1 power 16)
                   (let ((padded (concatenate 'string digits (zeros (- (+ power 2) (length digits))))))
                     (format nil "~a.~a" (subseq padded 0 (1+ power)) (subseq padded (1+ power)))))
                  ((< -5 power 0) (format nil "0.~a~a" (zeros (- -1 power)) digits))
                  (t (format nil "~a.~ae~d" (char digits 0) (if (string= "" (subseq digits 1)) "0" (subseq digits 1))
                             power))))))))

;;; Writing

(defun with-named-floats (form)
  "FORM with a symbol in the place of every float, whose name is its text: Maxima writes that as it is."
  (cond ((floatp form)
         (let ((symbol (make-symbol (float-text (abs form)))))
           (setf (get symbol 'maxima::reversealias) symbol)
           (if (minusp form) (list '(maxima::mminus) symbol) symbol)))
        ((atom form) form)
        (t (cons (car form) (mapcar #'with-named-floats (rest form))))))

(defvar *must-read-back* t "Whether a text that would be read as something else is an error.")

(defun script-text (form)
  "FORM as it is typed; a sentence where what is typed would be read as something else."
  (let ((text (typed-text (coerce (maxima::mstring (with-named-floats form)) 'string))))
    (unless (or (not *must-read-back*) (reads-back-p text form))
      (complain "~a cannot be written so that it reads back" (one-line (or (unwritable-part form) form) 60)))
    text))

(defun unwritable-part (form)
  "The smallest part of FORM that does not read back."
  (and (consp form)
       (some (lambda (part)
               (unless (reads-back-p (typed-text (coerce (maxima::mstring (with-named-floats part)) 'string)) part)
                 (or (unwritable-part part) part)))
             (rest form))))

;;; Reading, without evaluation

(defun reads-back-p (text form)
  (let ((read (read-without-evaluation text)))
    (and read (maxima::alike1 (by-verbs read) (by-verbs form)))))

(defun read-without-evaluation (text)
  "What TEXT is read as, simplified; nil where it cannot be read."
  (handler-case
      (with-input-from-string (stream (format nil "~a$" text))
        (let* ((*read-base* 10) (*package* (find-package :maxima))
               (*standard-output* (make-broadcast-stream)))
          (maxima::newline stream)
          (let ((statement (catch 'maxima::macsyma-quit (maxima::mread stream nil))))
            (and (consp statement) (maxima::simplify (as-evaluated (third statement)))))))
    (error () nil)))

(defun as-evaluated (form)
  "FORM, as it was read, with the operators that evaluation gives it."
  (cond ((atom form) form)
        ((operator-p form 'maxima::mquote) (as-evaluated (second form)))
        ((operator-p form 'maxima::$diff)
         (let ((parts (mapcar #'as-evaluated (rest form))))
           (cons '(maxima::%derivative) (if (evenp (length parts)) (append parts '(1)) parts))))
        (t (let* ((operator (caar form)) (noun (maxima::$nounify operator)))
             (cons (cons (cond ((get operator 'maxima::alias))
                               ((get noun 'maxima::operators) noun)
                               (t operator))
                         (cdar form))
                   (mapcar #'as-evaluated (rest form)))))))

(defun by-verbs (form)
  "FORM with verbs for nouns: which of the two stands for an unknown function makes no difference."
  (cond ((atom form) form)
        ((operator-p form 'maxima::mcond) (cons '(maxima::mcond) (mapcar #'by-verbs (rest form))))
        (t (cons (cons (maxima::$verbify (caar form)) (remove 'maxima::simp (cdar form)))
                 (mapcar #'by-verbs (rest form))))))

;;; Lines

(defvar *script-width* 100)

(defun break-p (text place)
  "Whether a line may end behind PLACE: not within a number, such as 1.0e-5, nor behind a marked character."
  (and (find (char text place) ",*+")
       (plusp place)
       (not (find (char text (1- place)) "\\^*"))
       (not (and (char= (char text place) #\+) (find (char text (1- place)) "eEdDbBfF")))))

(defun broken-text (text indentation)
  "TEXT in lines of *SCRIPT-WIDTH* characters, where there are places to break it; all but the first are indented."
  (with-output-to-string (out)
    (let ((start 0) (room (- *script-width* indentation)) (last nil) (quoted nil))
      (dotimes (place (length text))
        (when (char= (char text place) #\") (setq quoted (not quoted)))
        (when (and last (>= (- place start) room))
          (format out "~a~%~a" (subseq text start (1+ last)) (make-string indentation :initial-element #\Space))
          (setq start (1+ last) last nil))
        (when (and (not quoted) (break-p text place)) (setq last place)))
      (write-string (subseq text start) out))))

(maxima::defmfun maxima::$anmech_script_text (form)
  "anmech_script_text(expr): as it is typed in a script, each argument of a structure in lines of its own; a sentence if
it would not read back."
  (coerce
   (if (and (consp form) (get (caar form) 'shape))
       (format nil "~a(~{~%  ~a~^,~})" (plain-name (caar form))
               (mapcar (lambda (argument) (broken-text (script-argument argument) 4)) (rest form)))
       (broken-text (script-text form) 4))
   'simple-string))

(maxima::defmfun maxima::$anmech_shown_lines (form most width)
  "anmech_shown_lines(expr, most, width): the lines of anmech_script_text for people who only read them, the first MOST
of them, no wider than WIDTH if they can be broken."
  (let* ((*must-read-back* nil) (*script-width* width) (lines (lines-in (maxima::$anmech_script_text form))))
    (list* '(maxima::mlist maxima::simp)
           (mapcar (lambda (line) (coerce line 'simple-string))
                   (if (> (length lines) most) (append (subseq lines 0 most) '("  ...")) lines)))))

(defun lines-in (text)
  (with-input-from-string (stream text)
    (loop for line = (read-line stream nil) while line collect line)))

(defun script-argument (argument)
  (if (operator-p argument 'maxima::mequal)
      (format nil "~a = ~a" (script-text (second argument)) (script-text (third argument)))
      (script-text argument)))

;;; What was said of the names

(maxima::defmfun maxima::$anmech_own_facts (names)
  "anmech_own_facts([name, ...]): what the user has assumed of these names and no others, and the features that were
declared of them as lists [name, feature]."
  (labels ((listed (forms) (cons '(maxima::mlist maxima::simp) forms))
           (known-p (form)
             (cond ((symbolp form) (or (member form (rest names)) (maxima::$constantp form)))
                   ((atom form) t)
                   ((member 'maxima::array (cdar form)) (member form (rest names) :test #'maxima::alike1))
                   (t (every #'known-p (rest form)))))
           (named-p (form)
             (if (and (consp form) (not (member 'maxima::array (cdar form))))
                 (some #'named-p (rest form))
                 (member form (rest names) :test #'maxima::alike1))))
    (let ((facts (remove-duplicates (loop for context in (rest maxima::$contexts)
                                          append (rest (maxima::$facts context)))
                                    :test #'maxima::alike1 :from-end t)))
      (list '(maxima::mlist maxima::simp)
            (listed (remove-if-not (lambda (fact)
                                          (and (consp fact) (not (operator-p fact 'maxima::$kind))
                                               (known-p fact) (named-p fact)))
                                        facts))
            (listed (loop for fact in facts
                               when (and (operator-p fact 'maxima::$kind) (member (second fact) (rest names)))
                                 collect `((maxima::mlist maxima::simp) ,@(rest fact))))))))
